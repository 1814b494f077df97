"""The simulated Teensy against the protocol's text and against what the original firmware really sent.

test_captures.py holds the rest against long captures of it. Parser and encoders (teensy_bench) are shared with nothing.
"""

import pytest

import teensy_bench
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD, FORWARD, LEFT, RIGHT
from car_interface.sim.teensy_uart import Wire, frame_body, line_ns
from teensy_bench import MS, Bench, S, framed_for_the_receiver, message, ping, wheel_reports


def test_captured_frames_built_anew_and_a_boot_with_an_old_clock_are_the_captured_bytes():
    frames = teensy_bench.CAPTURED[1:]
    assert (len(teensy_bench.CAPTURE), len(frames)) == (22999, 795)
    for frame in frames:
        wire = b"\x7e" + frame_body(bytes.fromhex(frame["raw"])) + b"\x7e"
        assert wire == teensy_bench.CAPTURE[frame["start"] : frame["end"] + 1], frame["n"]
    # The first wheel report waits already while the boot frame is closed, so they share a flag.
    assert Bench(clock_start_ms=31400).until(10 * MS).sent == teensy_bench.CAPTURE[:42]


def test_pong_is_the_ping_s_own_packet_with_a_new_address_and_a_frame_for_somebody_else_is_dropped_silently():
    # The header's reserved byte and the sender's address come back as they went out.
    bench = Bench().write(framed_for_the_receiver(bytes([2, 9, teensy_bench.PING, 0x33]) + bytes(8)))
    bench.write(framed_for_the_receiver(message(teensy_bench.PING, bytes(8), dst=3))).until(50 * MS)
    assert [frame[:4] for frame in bench.frames(teensy_bench.PONG)] == [bytes([9, 2, teensy_bench.PONG, 0x33])]
    assert [bench.teensy.counters[name] for name in ("rxPackets", "rxErrorUnknown", "rxErrorChecksum")] == [2, 0, 0]


def test_bytes_from_the_host_arrive_at_the_line_s_pace():
    bench = Bench().write(bytes(1152))
    assert bench.teensy.receive_backlog(50 * MS) == 1152 - 576
    assert bench.teensy.counters["rxBytes"] == 576


def test_counters_asked_for_too_often_starve_sonars_and_wheels():
    bench = Bench(lambda sensor, at_ns: 3000).until(500 * MS)
    bench.write(teensy_bench.GOOD * 500).after(3 * S)
    assert bench.teensy.counters["txErrorNoBuf"] > 0
    # A sonar's report that found no packet scheduled no successor: silence, until somebody starts them again.
    sonars = len(bench.frames(teensy_bench.SONAR))
    assert len(bench.after(S).frames(teensy_bench.SONAR)) == sonars
    assert len(bench.command(teensy_bench.START).after(S).frames(teensy_bench.SONAR)) > sonars + 15


def test_bytes_that_come_while_it_boots_are_lost():
    bench = Bench().until(S)
    bench.teensy.reboot(bench.now_ns)
    bench.write(framed_for_the_receiver(ping(1))).after(400 * MS)
    assert not bench.frames(teensy_bench.PONG)
    assert bench.write(framed_for_the_receiver(ping(2))).after(10 * MS).frames(teensy_bench.PONG)


@pytest.mark.parametrize(
    ("drift_ppm", "ramp_ppm_per_h", "after_1h_ms"),
    [(40, 0, 3_600_144), (-100, 0, 3_599_640), (0, 20, 3_600_036), (100, -20, 3_600_324)],
)
def test_clock_drifts(drift_ppm, ramp_ppm_per_h, after_1h_ms):
    config = FirmwareConfig(clock_start_ms=0, clock_drift_ppm=drift_ppm, clock_ramp_ppm_per_h=ramp_ppm_per_h)
    teensy = TeensyFirmware(config)
    assert teensy.clock.device_ns(3600 * S) == pytest.approx(after_1h_ms * MS, abs=1000)
    assert teensy.clock.millis(3600 * S) in (after_1h_ms - 1, after_1h_ms)


def test_line_cut_loses_only_what_was_not_out():
    line = Wire()
    line.write(b"abcdef", 0)
    line.cut(line_ns(3))
    line.write(b"xyz", line_ns(4))
    assert line.collect(line_ns(4) + line_ns(1)) == b"abcx"
    assert line.collect(line_ns(8)) == b"yz"


def test_bytes_arrive_after_they_were_sent_however_late_those_before_are_taken():
    line = Wire()
    line.write(b"ab", 0)
    line.write(b"c", line_ns(1))
    line.write(b"d", line_ns(100))
    assert line.collect(line_ns(3) + 1) == b"abc" and line.backlog == 1
    assert line.next_ns == line_ns(100) + line_ns(1)


# Each pair is a hall state (pulses modulo 4 of a Gray code 0 1 3 2) and what the first pulses seem to be:
# (direction, dist, dist_abs). The levels are never read at power-up, and an interrupt reads its own pin only.
@pytest.mark.parametrize(("direction", "position", "seen"), [
    pytest.param(FORWARD, 0, [(0, 1, 1), (0, 1, 2), (0, 1, 3)], id="forward_from_00_is_right"),
    pytest.param(FORWARD, 1, [(1, 1, 1), (1, 1, 2), (0, 3, 3)], id="forward_from_01_seems_backward_twice"),
    pytest.param(BACKWARD, 3, [(0, 1, 1), (0, 1, 2), (1, 3, 3)], id="backward_from_10_seems_forward_twice"),
    pytest.param(BACKWARD, 2, [(2, 0, 1), (2, 0, 2), (1, 3, 3)], id="backward_from_11_has_no_direction_twice"),
    pytest.param(BACKWARD, 1, [(2, 0, 1), (1, 2, 2), (1, 2, 3)], id="backward_from_01_has_no_direction_once"),
])
def test_hall_pins_are_taken_for_00_at_power_up(direction, position, seen):
    bench = Bench(wheel_positions=(position, position + 4)).until(300 * MS)
    bench.roll(LEFT, direction, 3, 15 * MS).roll(RIGHT, direction, 3, 15 * MS).after(5 * MS)
    for side in (LEFT, RIGHT):
        reports = [report for report in wheel_reports(bench, side) if report.dist_abs]
        assert [(report.direction, report.dist, report.dist_abs) for report in reports[:2]] == seen[:2]
        assert (reports[-1].direction, reports[-1].dist, reports[-1].dist_abs) == seen[2]
