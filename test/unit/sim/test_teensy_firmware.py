"""The simulated Teensy against the protocol's text and against what the original firmware really sent.

test_captures.py holds the rest against long captures of it. Parser and encoders (teensy_bench) are shared with nothing.
"""

from car_interface.sim.teensy_transmitter import frame_body
from teensy_bench import (
    CAPTURE,
    CAPTURED,
    GOOD,
    MS,
    PING,
    PONG,
    SONAR,
    START,
    Bench,
    S,
    framed_for_the_receiver,
    message,
    ping,
)


def test_captured_frames_built_anew_are_the_captured_bytes():
    frames = CAPTURED[1:]
    assert (len(CAPTURE), len(frames)) == (22999, 795)
    for frame in frames:
        wire = b"\x7e" + frame_body(bytes.fromhex(frame["raw"])) + b"\x7e"
        assert wire == CAPTURE[frame["start"] : frame["end"] + 1], frame["n"]


def test_boot_with_an_old_clock_sends_the_capture_s_first_42_bytes():
    # The first wheel report waits already while the boot frame is closed, so they share a flag.
    assert Bench(clock_start_ms=31400).until(10 * MS).sent == CAPTURE[:42]


def test_pong_is_the_ping_s_own_packet_with_a_new_address_and_a_frame_for_somebody_else_is_dropped_silently():
    # The header's reserved byte and the sender's address come back as they went out.
    bench = Bench().write(framed_for_the_receiver(bytes([2, 9, PING, 0x33]) + bytes(8)))
    bench.write(framed_for_the_receiver(message(PING, bytes(8), dst=3))).until(50 * MS)
    assert [frame[:4] for frame in bench.frames(PONG)] == [bytes([9, 2, PONG, 0x33])]
    assert [bench.teensy.counters[name] for name in ("rxPackets", "rxErrorUnknown", "rxErrorChecksum")] == [2, 0, 0]


def test_bytes_from_the_host_arrive_at_the_line_s_pace():
    bench = Bench().write(bytes(1152))
    assert bench.teensy.receive_backlog(50 * MS) == 1152 - 576
    assert bench.teensy.counters["rxBytes"] == 576


def test_counters_asked_for_too_often_starve_sonars_and_wheels():
    bench = Bench(lambda sensor, at_ns: 3000).until(500 * MS)
    bench.write(GOOD * 500).after(3 * S)
    assert bench.teensy.counters["txErrorNoBuf"] > 0
    # A sonar's report that found no packet scheduled no successor: silence, until somebody starts them again.
    sonars = len(bench.frames(SONAR))
    assert len(bench.after(S).frames(SONAR)) == sonars
    assert len(bench.command(START).after(S).frames(SONAR)) > sonars + 15


def test_bytes_that_come_while_it_boots_are_lost():
    bench = Bench().until(S)
    bench.teensy.reboot(bench.now_ns)
    bench.write(framed_for_the_receiver(ping(1))).after(400 * MS)
    assert not bench.frames(PONG)
    assert bench.write(framed_for_the_receiver(ping(2))).after(10 * MS).frames(PONG)
