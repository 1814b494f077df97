"""The simulated Teensy against the protocol's text and against what the original firmware really sent.

Its wheels, sonars, loop and restarts are told here as rules, one test each; test_sim_captures.py holds the same rules
against long captures of the original.

The parser and the encoders in here are written from the protocol's description alone and are shared with nothing.
"""

import json
import random
import struct
from collections import namedtuple
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.sim.teensy_firmware import (
    BACKWARD,
    COUNTER_NAMES,
    FORWARD,
    LEFT,
    RIGHT,
    SONAR_FINE,
    SONAR_MISSING,
    SONAR_STUCK,
    FirmwareConfig,
    OutgoingLine,
    PacketPool,
    Receiver,
    TeensyFirmware,
    frame_body,
)

MS, S = 1_000_000, 1_000_000_000
PING, PONG, SET_SEQ, STOP, START, SONAR, WHEELS, RESET, COUNTER, GET_COUNTERS, WAIT = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12

DATA = Path(__file__).resolve().parents[2] / "data"
CAPTURE = (DATA / "capture_mixed.bin").read_bytes()
CAPTURED = [json.loads(line) for line in (DATA / "capture_mixed.jsonl").read_text().splitlines()]

Wheel = namedtuple("Wheel", "speed direction reserved when dist dist_abs")
Sonar = namedtuple("Sonar", "sensor filler echo_us when")


# From the wire, by the text


def split_frames(data):
    """Bytes → unescaped frames without their checksums; empty ones and the boot frame left out."""
    found = []
    for chunk in data.split(b"\x7e")[1:-1]:
        plain, escaped = bytearray(), False
        for byte in chunk:
            if byte == 0x7D:
                escaped = True
            else:
                plain.append(byte ^ 0x20 if escaped else byte)
                escaped = False
        if len(plain) >= 5:
            total = sum(plain)
            while total > 0xFF:
                total = (total & 0xFF) + (total >> 8)
            assert total == 0xFF, plain.hex()
            found.append(bytes(plain[:-1]))
    return found


def parse_wheels(frame):
    return Wheel(*struct.unpack_from("<HBBIII", frame, 4)), Wheel(*struct.unpack_from("<HBBIII", frame, 20))


def wheel_bytes(wheel):
    return struct.pack("<HBBIII", *wheel)


def parse_sonar(frame):
    return Sonar(*struct.unpack_from("<BBHI", frame, 4))


def parse_counter(frame):
    assert frame[-1] == 0 and 0 not in frame[8:-1]
    return frame[8:-1].decode("ascii"), struct.unpack_from("<I", frame, 4)[0]


# To the wire, by the text


def stuffed(data):
    return b"".join(bytes([0x7D, byte ^ 0x20]) if byte in (0x7D, 0x7E) else bytes([byte]) for byte in data)


def framed_for_the_receiver(message):
    """The receiver's own checksum: 7e, stuffed message, checksum, 7e."""
    for reserved in (stuffed(message[3:4]), b"\x7d\x20"):
        wire = stuffed(message[:3]) + reserved + stuffed(message[4:])
        checksum = 0xFF - sum(byte for byte in wire if byte != 0x7D) % 256
        if checksum not in (0x7D, 0x7E):
            break
    return b"\x7e" + wire + bytes([checksum]) + b"\x7e"


def framed_by_the_textbook(message):
    total = sum(message)
    while total > 0xFF:
        total = (total & 0xFF) + (total >> 8)
    return b"\x7e" + stuffed(message + bytes([0xFF - total])) + b"\x7e"


def message(command, payload=b"", dst=2):
    return bytes([dst, 1, command, 0]) + payload


def ping(timestamp1):
    return message(PING, struct.pack("<II", timestamp1, 0))


def received(wire, corrected=False):
    """What a receiver alone makes of ``wire``: the packets that it accepts, and its counters."""
    counters = dict.fromkeys(COUNTER_NAMES, 0)
    pool = PacketPool(4, None)
    receiver = Receiver(pool.take, counters, corrected)
    accepted = []
    for byte in wire:
        packet = receiver.byte(byte)
        if packet is not None:
            accepted.append(bytes(packet))
            pool.give(packet)
    return accepted, counters


class Bench:
    """A Teensy on a table: pass time, write to it, read what it sends."""

    def __init__(self, echo_us=None, **config):
        self.teensy = TeensyFirmware(FirmwareConfig(**config), echo_us)
        self.now_ns = 0
        self.sent = b""
        self.read = 0

    def until(self, at_ns):
        self.now_ns = max(at_ns, self.now_ns)
        self.sent += self.teensy.transmit(self.now_ns)
        return self

    def after(self, span_ns):
        return self.until(self.now_ns + span_ns)

    def write(self, wire):
        self.teensy.receive(wire, self.now_ns)
        return self

    def command(self, command, payload=b""):
        return self.write(framed_for_the_receiver(message(command, payload)))

    def roll(self, side, direction, pulses, every_ns):
        for _ in range(pulses):
            self.until(self.now_ns + every_ns)
            self.teensy.wheel_pulse(side, direction, self.now_ns)
        return self

    def frames(self, command):
        return [frame for frame in split_frames(self.sent) if frame[2] == command]

    def fresh(self, command):
        """Frames since the last call, whichever command it was for."""
        start, self.read = self.read, self.sent.rindex(b"\x7e") if b"\x7e" in self.sent else 0
        frames = split_frames(b"\x7e" + self.sent[start:].lstrip(b"\x7e"))
        return [frame for frame in frames if frame[2] == command]

    def counters(self):
        self.command(GET_COUNTERS).after(200 * MS)
        return dict(parse_counter(frame) for frame in self.fresh(COUNTER))


# What the original sent


def test_captured_frames_built_anew_are_the_captured_bytes():
    frames = CAPTURED[1:]
    assert (len(CAPTURE), len(frames)) == (22999, 795)
    for frame in frames:
        wire = b"\x7e" + frame_body(bytes.fromhex(frame["raw"])) + b"\x7e"
        assert wire == CAPTURE[frame["start"] : frame["end"] + 1], frame["n"]


def test_capture_parsed_by_this_test_holds_what_its_description_says():
    frames = split_frames(CAPTURE)
    assert [frame.hex() for frame in frames] == [line["raw"] for line in CAPTURED[1:]]
    assert sum(sum(frame) > 0xFF for frame in frames) == 773


def test_boot_with_an_old_clock_sends_the_capture_s_first_42_bytes():
    # The first wheel report waits already while the boot frame is closed, so they share a flag.
    assert Bench(clock_start_ms=31400).until(10 * MS).sent == CAPTURE[:42]


def test_boot_frame_shares_its_flag_with_the_first_report_whatever_the_clock_says():
    assert Bench().until(10 * MS).sent == Bench(clock_start_ms=31400).until(10 * MS).sent


def test_captured_flags_are_shared_where_the_simulator_shares_them():
    # Counters wait in a queue: 26 of 26 share. A sonar's report after a sonar's report never does.
    gaps = {}
    for first, second in zip(CAPTURED[1:], CAPTURED[2:]):
        gaps.setdefault((first["cmd"], second["cmd"]), []).append(second["start"] - first["end"])
    assert set(gaps[COUNTER, COUNTER]) == {0} and set(gaps[SONAR, SONAR]) == {1}

    burst = Bench().until(400 * MS).command(GET_COUNTERS).after(20 * MS).sent
    first, last = burst.index(b"txBytes"), burst.index(b"rxPackets")
    assert b"\x7e\x7e" not in burst[first:last]
    # Four counters share three flags, the boot frame and the first report one.
    assert burst.count(b"\x7e\x7e") == len(split_frames(burst)) - 4


def captured_wheel_story():
    """The capture's wheels as events: ("pulse", tick, side, direction, known) and ("reset", tick), and their reports.

    A pulse that no report shows the time of came within 5 ms of a report: it's put 2 ms after the last one.
    """
    events, reports = [], []
    seen, reported_tick = [0, 0], 0
    for line in CAPTURED[1:]:
        if line["cmd"] != WHEELS:
            if line["cmd"] == COUNTER and line["name"] == "rotUpdSkip":
                events.append(("skips", reported_tick + 1, line["count"]))
            continue
        wheels = line["left"], line["right"]
        newest = [wheel["when"] if wheel["dist_abs"] != old else 0 for wheel, old in zip(wheels, seen)]
        if any(wheel["dist_abs"] < old for wheel, old in zip(wheels, seen)):
            events.append(("reset", max(newest) - 3))
            seen = [0, 0]
        fresh = []
        for side, wheel in enumerate(wheels):
            for missing in range(wheel["dist_abs"] - seen[side] - 1, -1, -1):
                tick = reported_tick + 2 if missing else wheel["when"]
                fresh.append(("pulse", tick, side, wheel["direction"], not missing))
            seen[side] = wheel["dist_abs"]
        events += sorted(fresh, key=lambda event: event[1])
        if fresh:
            reported_tick = max(event[1] for event in fresh)
            reports.append(line)
    return events, reports


def test_captured_pulses_fed_to_the_simulator_give_the_captured_wheel_reports():
    events, expected = captured_wheel_story()
    bench = Bench(clock_start_ms=31400)
    speeds_known, known, history = [], [True, True], ([], [])
    for event in events:
        bench.until((event[1] - 31400) * MS + MS // 2)
        if event[0] == "reset":
            bench.write(framed_for_the_receiver(message(RESET)))
        elif event[0] == "skips":
            assert bench.teensy.counters["rotUpdSkip"] == event[2]
        else:
            _, _, side, direction, time_is_known = event
            history[side].append(time_is_known)
            before = bench.teensy.counters["rotUpdSkip"]
            bench.teensy.wheel_pulse(side, direction, bench.now_ns)
            if bench.teensy.counters["rotUpdSkip"] == before:
                speeds_known.append([all(times[-11:]) for times in history])
    sent = [parse_wheels(frame) for frame in bench.after(50 * MS).frames(WHEELS)][1:]

    assert len(sent) == len(expected) == len(speeds_known) == 444
    compared = 0
    for wheels, line, known in zip(sent, expected, speeds_known):
        for wheel, side, speed_known in zip(wheels, ("left", "right"), known):
            assert wheel[1:] == tuple(line[side][name] for name in Wheel._fields[1:]), line["n"]
            if speed_known:
                assert wheel.speed == line[side]["speed"], line["n"]
                compared += 1
    assert compared > 550


def test_captured_sonars_keep_the_simulator_s_rhythm():
    """From one report to the next: the wait, what the echo takes, and 0 to 2 ms of tick and loop."""

    def idle_ms(reports, wait_ms):
        pairs = [(first, second) for first, second in zip(reports, reports[1:]) if second[1] < 11_429 and first[1]]
        return [second[2] - first[2] - wait_ms - second[1] / 1000 for first, second in pairs]

    captured = [(line["sensor"], line["distance"], line["when"]) for line in CAPTURED[1:270] if line["cmd"] == SONAR]
    idle = sorted(idle_ms([report for report in captured if report[1]], 50))
    assert 0.0 < idle[len(idle) // 2] < 2.0

    bench = Bench(lambda sensor, at_ns: 1000 + 1500 * sensor).until(5 * S)
    simulated = [(report.sensor, report.echo_us, report.when) for report in map(parse_sonar, bench.frames(SONAR))]
    assert all(0.0 < idle < 2.1 for idle in idle_ms(simulated, 50))


# The receiver


def states_and_how_to_reach_them():
    """Every state of the receiver, by trying from each one found all kinds of bytes: (phase, filled) → wire."""
    found, new = {}, [b""]
    kinds = (b"\x7e", b"\x7d", b"\x00", framed_for_the_receiver(message(GET_COUNTERS)))
    while new:
        wire = new.pop(0)
        state = receiver_after(wire).state
        if state not in found:
            found[state] = wire
            new += [wire + kind for kind in kinds]
    return found


def receiver_after(wire):
    receiver = Receiver(PacketPool(9, None).take, dict.fromkeys(COUNTER_NAMES, 0))
    for byte in wire:
        receiver.byte(byte)
    return receiver


def test_receiver_has_78_states():
    found = states_and_how_to_reach_them()
    assert len(found) == 78
    assert {phase for phase, _ in found} == {"idle", "waiting", "data", "escaped"}


def test_receiver_in_any_state_waits_for_a_flag_after_39_zeros():
    for state, wire in states_and_how_to_reach_them().items():
        assert receiver_after(wire + bytes(39)).state == ("waiting", 0), state


def test_receiver_in_one_state_does_not_after_38_zeros():
    stuck = [
        state
        for state, wire in states_and_how_to_reach_them().items()
        if receiver_after(wire + bytes(38)).state != ("waiting", 0)
    ]
    assert stuck == [("escaped", 37)]


@given(command=st.integers(0, 255), payload=st.binary(max_size=32))
def test_frame_with_the_receiver_s_own_checksum_and_any_payload_is_accepted(command, payload):
    accepted, counters = received(framed_for_the_receiver(message(command, payload)))
    assert len(accepted) == 1 and accepted[0].startswith(message(command, payload))
    assert counters["rxErrorDropped"] == counters["rxErrorChecksum"] == 0


@given(command=st.integers(0, 255), payload=st.binary(max_size=32))
def test_frame_of_the_textbook_and_any_payload_is_accepted_by_a_corrected_firmware(command, payload):
    accepted, _ = received(framed_by_the_textbook(message(command, payload)), corrected=True)
    assert len(accepted) == 1 and accepted[0].startswith(message(command, payload))


@given(payload=st.binary(max_size=32))
def test_own_checksum_where_nothing_carries_or_escapes_is_the_textbook_s(payload):
    whole = message(GET_COUNTERS, payload)
    nothing_escapes = not {0x7D, 0x7E} & set(whole + bytes([(0xFF - sum(whole)) % 256]))
    if sum(whole) <= 0xFF and nothing_escapes:
        assert framed_for_the_receiver(whole) == framed_by_the_textbook(whole)


def share_answered(timestamps):
    answered = sum(len(received(framed_by_the_textbook(ping(timestamp1)))[0]) for timestamp1 in timestamps)
    return answered / len(timestamps)


def test_textbook_pings_with_the_millisecond_within_the_minute_are_answered_half_the_time():
    assert share_answered(range(0, 60_000, 29)) == pytest.approx(0.51, abs=0.015)


def test_textbook_pings_with_a_free_running_counter_are_answered_one_time_in_twenty():
    # Over all 32-bit values it's 3.9 %; how much a counter gets in a few minutes hangs on its upper bytes.
    draw = random.Random(2)
    assert 0.035 <= share_answered([draw.getrandbits(32) for _ in range(8000)]) <= 0.06


@given(st.lists(st.integers(0, 251), min_size=4, max_size=4))
def test_friendly_timestamp_is_accepted_by_both_firmwares_as_the_textbook_frames_it(token):
    if sum(token) > 251 or sum(token) in (125, 126) or {0x7D, 0x7E} & set(token):
        return
    wire = framed_by_the_textbook(message(PING, bytes(token) + bytes(4)))
    assert len(received(wire)[0]) == len(received(wire, corrected=True)[0]) == 1


def test_sum_that_carries_is_refused_with_the_carry_and_taken_without():
    whole = message(WAIT, b"\xff\x10\x00\x00")
    assert not received(framed_by_the_textbook(whole))[0]
    assert received(framed_for_the_receiver(whole))[0]


def test_escaped_byte_is_summed_as_it_came_and_the_escape_not_at_all():
    # 02 01 0c 00 | 7e 00 00 00: summed as 5e the total is 6d; the checksum that makes it ff is 92.
    assert received(bytes.fromhex("7e02010c007d5e000000927e"))[0]
    assert not received(bytes.fromhex("7e02010c007d5e000000727e"))[0]


GOOD = framed_for_the_receiver(message(GET_COUNTERS))


@pytest.mark.parametrize(
    ("wire", "accepted"),
    [
        pytest.param(GOOD * 3, 3, id="each_with_its_own_flags"),
        pytest.param(b"\x00\x55\x7d" + GOOD, 1, id="noise_before"),
        pytest.param(GOOD[:-1] + GOOD[:-1] + GOOD, 2, id="shared_flags_lose_every_second"),
        pytest.param(b"\x7e" + GOOD * 20, 0, id="one_odd_flag_before_loses_all"),
        pytest.param(b"\x7e" + GOOD * 20 + b"\x7e" + GOOD, 1, id="until_another_odd_flag"),
        pytest.param(GOOD[1:] + GOOD * 20, 0, id="a_missing_opening_flag_loses_all"),
        pytest.param(GOOD[:-1] + GOOD * 20, 1, id="a_missing_closing_flag_loses_all_later"),
        pytest.param(b"\x7e" + bytes(37) + b"\x7e" + GOOD, 1, id="36_bytes_and_a_wrong_checksum_lose_one"),
        pytest.param(b"\x7e" + bytes(38) + b"\x7e" + GOOD * 20, 0, id="37_bytes_before_the_checksum_lose_all"),
        pytest.param(b"\x7e" + GOOD * 9 + bytes(39) + GOOD, 1, id="39_zeros_bring_it_back"),
        pytest.param(b"\x7e\x02\x01\x7d" + GOOD, 0, id="an_escaped_flag_is_data"),
    ],
)
def test_receiver_accepts(wire, accepted):
    assert len(received(wire)[0]) == accepted


@given(st.binary(max_size=200), st.data())
def test_receiver_fed_in_any_pieces_answers_alike(noise, data):
    wire = noise + bytes(39) + GOOD + framed_for_the_receiver(ping(7))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(wire)), max_size=5)))
    whole, pieces = Bench(), Bench()
    whole.write(wire)
    for start, end in zip([0, *cuts], [*cuts, len(wire)]):
        pieces.write(wire[start:end])
    assert whole.until(150 * MS).sent == pieces.until(150 * MS).sent
    assert whole.frames(PONG)


@pytest.mark.parametrize(
    ("wire", "counter", "count"),
    [
        pytest.param(b"\x7e\x02\x01\x0a\x00\x01\x7e", "rxErrorChecksum", 1, id="wrong_checksum"),
        pytest.param(b"\x7e\x7e", "rxErrorChecksum", 1, id="empty_frame"),
        pytest.param(b"\x7e\x02\x01\x0a\xf2\x7e", "rxErrorTooShort", 1, id="less_than_a_header"),
        pytest.param(b"\x7e" + bytes(38), "rxErrorTooLong", 1, id="more_than_any_message"),
        pytest.param(b"\x01\x02\x03", "rxErrorDropped", 3, id="bytes_outside_of_frames"),
        pytest.param(GOOD, "rxPackets", 1, id="good_frame"),
        pytest.param(GOOD, "rxBytes", 7, id="bytes_of_a_good_frame"),
    ],
)
def test_receiver_counts(wire, counter, count):
    assert received(wire)[1][counter] == count


# Pings


def test_pings_with_the_receiver_s_checksum_are_all_answered():
    bench = Bench()
    tokens = [random.Random(4).getrandbits(32) for _ in range(2)] + [0x7E7D7E7D, 0x7D7D7D7D, 0, 125, 891, 0xFFFFFFFF]
    for token in tokens:
        bench.write(framed_for_the_receiver(ping(token))).after(10 * MS)
    assert [struct.unpack_from("<I", frame, 4)[0] for frame in bench.frames(PONG)] == tokens


def test_pong_carries_the_tick_at_which_the_ping_s_last_byte_came():
    # 15 bytes at 86.8 µs: complete 1.302 ms after the host began to write; the loop passes every 50 µs.
    for sent_us, tick in ((8_500, 309), (8_640, 309), (8_699, 310)):
        bench = Bench().until(sent_us * 1000).write(framed_for_the_receiver(ping(5))).after(5 * MS)
        assert bench.frames(PONG) == [bytes([1, 2, 2, 0]) + struct.pack("<II", 5, tick)]


def test_pong_is_the_ping_s_own_packet_with_a_new_address():
    # The header's reserved byte and the sender's address come back as they went out.
    bench = Bench().write(framed_for_the_receiver(bytes([2, 9, PING, 0x33]) + bytes(8))).until(9 * MS)
    assert bench.frames(PONG)[0][:4] == bytes([9, 2, PONG, 0x33])


def test_frame_for_somebody_else_is_dropped_silently():
    bench = Bench().write(framed_for_the_receiver(message(PING, bytes(8), dst=3))).until(50 * MS)
    assert not bench.frames(PONG)
    assert {name: bench.teensy.counters[name] for name in ("rxPackets", "rxErrorUnknown", "rxErrorChecksum")} == {
        "rxPackets": 1,
        "rxErrorUnknown": 0,
        "rxErrorChecksum": 0,
    }


@pytest.mark.parametrize("command", [0, 6, 7, 9, 11, 13, 255])
def test_unknown_command_is_counted_and_harmless(command):
    bench = Bench().command(command).until(10 * MS)
    assert bench.teensy.counters["rxErrorUnknown"] == 1
    assert bench.write(framed_for_the_receiver(ping(1))).after(10 * MS).frames(PONG)


def test_bytes_from_the_host_arrive_at_the_line_s_pace():
    bench = Bench().write(bytes(1152))
    assert bench.teensy.receive_backlog(50 * MS) == 1152 - 576
    assert bench.teensy.counters["rxBytes"] == 576


# The line


@settings(max_examples=25)
@given(st.lists(st.integers(1, 30 * MS), min_size=1, max_size=40), st.sampled_from([9600, 57600, 115200]))
def test_line_never_sends_faster_than_its_baud_rate(spans_ns, baud):
    bench = Bench(lambda sensor, at_ns: 300, baud=baud, sonar_wait_ms=0)
    for span_ns in spans_ns:
        before = len(bench.sent)
        bench.after(span_ns).command(GET_COUNTERS)
        # Of the byte that is on the wire at the start of the span all but the last bit may be out already.
        assert len(bench.sent) - before <= span_ns * baud / (10 * S) + 1


def test_line_asked_more_often_sends_the_same_bytes():
    seldom, often = (Bench(lambda sensor, at_ns: 700 * sensor, sonar_wait_ms=0) for _ in range(2))
    for at_us in range(0, 300_000, 130):
        often.until(at_us * 1000)
    assert often.until(S).sent == seldom.until(S).sent
    assert len(seldom.sent) > 1000


def test_line_cut_loses_only_what_was_not_out():
    line = OutgoingLine(baud=10_000, buffer_size=64)  # a byte each millisecond
    line.write(b"abcdef", 0)
    line.cut(3 * MS)
    line.write(b"xyz", 4 * MS)
    assert line.collect(5 * MS) == b"abcx"
    assert line.collect(10 * MS) == b"yz"


def test_saturated_line_drops_old_sonar_reports_and_counts_them():
    bench = Bench(lambda sensor, at_ns: 100, sonar_wait_ms=0).until(3 * S)
    counters = bench.teensy.counters
    assert counters["txInfoSonarDrop"] > 100
    assert counters["txErrorNoBuf"] == 0
    assert len(bench.sent) == pytest.approx(3 * 11520, rel=0.01)


def test_saturated_line_drops_old_wheel_reports_and_counts_them():
    bench = Bench(baud=9600).roll(LEFT, FORWARD, 300, every_ns=6 * MS)
    assert bench.teensy.counters["txInfoWheelDrop"] > 100
    reports = [parse_wheels(frame)[0].dist_abs for frame in bench.after(500 * MS).frames(WHEELS)]
    assert reports == sorted(reports) and reports[-1] == 300


# Counters


def test_counters_asked_for_are_the_non_zero_ones_in_their_order():
    bench = Bench().until(300 * MS).write(b"\x00")
    bench.command(GET_COUNTERS).after(50 * MS)
    answer = [parse_counter(frame) for frame in bench.frames(COUNTER)]
    assert [name for name, _ in answer] == ["rxErrorDropped", "txBytes", "txPackets", "rxBytes", "rxPackets"]
    assert dict(answer)["rxBytes"] == 8 and dict(answer)["rxPackets"] == 1


def test_counters_of_the_capture_mean_what_the_simulator_counts():
    # txBytes: every byte before the first counter's frame. txPackets: the frames before it, without the boot frame.
    for line in CAPTURED[1:]:
        if line["cmd"] == COUNTER and line["name"] == "txBytes":
            first = next(n for n in range(line["n"], 0, -1) if CAPTURED[n - 1]["cmd"] != COUNTER)
            assert line["count"] == CAPTURED[first]["start"]
            assert CAPTURED[line["n"] + 1]["count"] == first - 1
    bench = Bench().until(500 * MS)
    sent_before = len(bench.sent)
    counters = bench.counters()
    assert counters["txBytes"] == sent_before
    assert counters["txPackets"] == len(split_frames(bench.sent[:sent_before]))


def test_counter_names_of_the_capture_come_in_the_simulator_s_order():
    bursts, names = [], []
    for line in CAPTURED[1:]:
        names = [*names, line["name"]] if line["cmd"] == COUNTER else []
        bursts.append([COUNTER_NAMES.index(name) for name in names])
    assert all(burst == sorted(burst) for burst in bursts) and max(map(len, bursts)) == 8


def test_counters_asked_for_once_a_second_starve_nothing():
    bench = Bench(lambda sensor, at_ns: 3000)
    for _ in range(20):
        bench.command(GET_COUNTERS).after(S)
    assert bench.teensy.counters["txErrorNoBuf"] == bench.teensy.counters["rxErrorBuffer"] == 0
    assert len(bench.frames(SONAR)) > 300


def test_counters_asked_for_too_often_starve_sonars_and_wheels():
    bench = Bench(lambda sensor, at_ns: 3000).until(500 * MS)
    bench.write(GOOD * 500).after(3 * S)
    assert bench.teensy.counters["txErrorNoBuf"] > 0
    # A sonar's report that found no packet scheduled no successor: silence, until somebody starts them again.
    sonars = len(bench.frames(SONAR))
    assert len(bench.after(S).frames(SONAR)) == sonars
    assert len(bench.command(START).after(S).frames(SONAR)) > sonars + 15


def test_counters_asked_for_too_often_between_pings_bring_the_receiver_out_of_step():
    bench = Bench(lambda sensor, at_ns: 3000).until(500 * MS)
    for _ in range(40):
        bench.command(GET_COUNTERS).write(framed_for_the_receiver(ping(1))).after(MS)
    assert bench.after(S).teensy.counters["rxErrorBuffer"] > 0
    answered = len(bench.frames(PONG))
    assert answered < 40
    assert len(bench.write(framed_for_the_receiver(ping(2))).after(S).frames(PONG)) == answered
    assert len(bench.write(bytes(39) + framed_for_the_receiver(ping(3))).after(S).frames(PONG)) == answered + 1


# Wheels


def wheel_reports(bench, side=LEFT):
    return [parse_wheels(frame)[side] for frame in bench.frames(WHEELS)]


def fields(wheel):
    """As the captures' description writes them: speed, direction, when, dist, dist_abs."""
    return wheel.speed, wheel.direction, wheel.when, wheel.dist, wheel.dist_abs


def test_first_report_after_a_boot_comes_at_once_and_says_nothing():
    bench = Bench().until(5 * MS)
    assert [fields(wheel) for wheel in parse_wheels(bench.frames(WHEELS)[0])] == [(0, 2, 0, 0, 0)] * 2


def test_wheels_that_have_never_turned_are_reported_every_201_ms_without_a_tick():
    bench = Bench().until(2020 * MS)
    assert len(bench.frames(WHEELS)) == 11
    assert set(bench.frames(WHEELS)) == {bytes([1, 2, WHEELS, 0]) + wheel_bytes(Wheel(0, 2, 0, 0, 0, 0)) * 2}


def test_wheels_that_stand_repeat_their_newest_entry_every_201_ms_with_the_present_tick():
    bench = Bench().until(500 * MS).roll(LEFT, FORWARD, 3, 30 * MS).roll(RIGHT, FORWARD, 3, 30 * MS).after(2 * S)
    reports = bench.frames(WHEELS)[-8:]
    for before, after in zip(reports, reports[1:]):
        for old, new in zip(parse_wheels(before), parse_wheels(after)):
            assert (new.dist, new.dist_abs, new.when - old.when) == (old.dist, old.dist_abs, 201)
    assert len({wheel.when for wheel in parse_wheels(reports[-1])}) == 1


@settings(max_examples=60)
@given(stop_ms=st.integers(300, 1500))
def test_first_repeat_comes_201_to_402_ms_after_the_last_pulse_s_report(stop_ms):
    bench = Bench().until((stop_ms - 50) * MS).roll(LEFT, FORWARD, 2, 25 * MS).after(S)
    ticks = [report.when for report in wheel_reports(bench)]
    last = 300 + stop_ms
    assert 201 <= ticks[ticks.index(last) + 1] - last <= 402


def test_first_repeat_s_time_goes_round_with_the_stop_s():
    gaps = set()
    for stop_ms in range(500, 701, 10):
        bench = Bench().until(stop_ms * MS).roll(LEFT, FORWARD, 1, MS).after(S)
        first, second = [report.when for report in wheel_reports(bench) if report.when][:2]
        gaps.add(second - first)
    assert min(gaps) < 215 and max(gaps) > 390


def test_wheel_that_stands_beside_one_that_turns_is_never_repeated():
    bench = Bench().until(500 * MS).roll(RIGHT, FORWARD, 12, 30 * MS).after(10 * MS)
    before = wheel_reports(bench, RIGHT)[-1]
    bench.roll(LEFT, FORWARD, 60, 100 * MS)
    assert len(bench.frames(WHEELS)) > 60
    assert wheel_reports(bench, RIGHT)[-1] == before and before.speed == 33


def test_wheel_that_has_never_turned_has_no_tick_beside_one_that_has():
    left, right = parse_wheels(Bench().until(S).roll(RIGHT, BACKWARD, 1, MS).after(2 * S).frames(WHEELS)[-1])
    assert (left.when, left.direction) == (0, 2)
    assert right.when > 3000


def test_wheels_that_race_are_reported_every_5_ms_and_no_pulse_is_lost():
    bench = Bench().until(500 * MS)
    bench.roll(LEFT, FORWARD, 1000, every_ns=1_070_000)  # 14 m/s
    reports = wheel_reports(bench.after(400 * MS))
    racing = [report.when for report in reports if 0 < report.dist_abs < 1000]
    assert {later - earlier for earlier, later in zip(racing, racing[1:])} <= {5, 6, 7}
    assert reports[-1].dist_abs == 1000
    assert bench.teensy.counters["rotUpdSkip"] + len(racing) in (999, 1000)


@pytest.mark.parametrize(("gap_ms", "reported"), [(4, False), (5, True)])
def test_pulse_within_5_ms_of_a_reported_one_waits_for_the_next_report(gap_ms, reported):
    bench = Bench().until(300 * MS)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 300 * MS)
    bench.teensy.wheel_pulse(RIGHT, FORWARD, (300 + gap_ms) * MS)
    bench.until(390 * MS)
    assert wheel_reports(bench, RIGHT)[-1].dist_abs == int(reported)
    assert bench.teensy.counters["rotUpdSkip"] == int(not reported)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 391 * MS)
    right = wheel_reports(bench.until(400 * MS), RIGHT)[-1]
    assert (right.dist_abs, right.when) == (1, 600 + gap_ms)


def test_pulse_that_waits_comes_with_a_repeat_at_the_latest_and_loses_its_tick():
    bench = Bench().until(300 * MS)
    bench.teensy.wheel_pulse(LEFT, FORWARD, 300 * MS)
    bench.teensy.wheel_pulse(RIGHT, FORWARD, 304 * MS)
    left, right = parse_wheels(bench.until(720 * MS).frames(WHEELS)[-1])
    assert right.dist_abs == 1 and right.when == left.when > 800


def test_wheel_that_turns_back_splits_the_way_at_dist():
    bench = Bench().roll(LEFT, FORWARD, 12, 40 * MS).roll(LEFT, BACKWARD, 5, 40 * MS).roll(LEFT, FORWARD, 3, 40 * MS)
    reports = wheel_reports(bench.after(20 * MS))
    turned = [report for report in reports if report.dist == report.dist_abs and report.dist]
    assert [(report.direction, report.dist, report.speed) for report in turned] == [(0, 1, 0), (1, 13, 0), (0, 18, 0)]
    assert reports[-1].dist_abs == 20

    travel, before = 0, Wheel(0, 2, 0, 0, 0, 0)
    for report in reports:
        step = report.dist_abs - before.dist_abs
        if report.direction != before.direction and report.dist_abs:
            old = report.dist - 1 - before.dist_abs
            travel += old * (-1 if before.direction == BACKWARD else 1)
            step -= old
        travel += step * (-1 if report.direction == BACKWARD else 1)
        before = report
    assert travel == 12 - 5 + 3


def test_speed_is_the_mean_over_ten_intervals():
    bench = Bench().until(30 * MS).roll(LEFT, FORWARD, 20, 20 * MS).roll(LEFT, FORWARD, 10, 40 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs]
    assert speeds[:20] == [0] + [50] * 19
    assert speeds[20:] == [10_000 // (200 + 20 * slow) for slow in range(1, 11)]


def test_speed_after_a_stop_falls_to_zero_with_nine_reports():
    bench = Bench().until(3 * MS).roll(LEFT, FORWARD, 30, 20 * MS).after(4 * S)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs == 30]
    assert speeds[0] == 50 and speeds[1:] == sorted(speeds[1:], reverse=True)
    assert speeds.index(0) in (9, 10)  # nine of the ten intervals are repeats, or the tenth is below 1/s


def test_speed_after_a_start_in_the_same_direction_is_too_low_for_a_dozen_pulses():
    bench = Bench().roll(LEFT, FORWARD, 20, 20 * MS).after(3 * S).roll(LEFT, FORWARD, 30, 20 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.dist_abs > 20]
    assert speeds[0] < 2 and speeds[:7] == sorted(speeds[:7]) and max(speeds[:7]) < 20
    assert len(speeds) > 25 and set(speeds[12:]) == {50}


def test_speed_of_the_first_pulse_after_a_change_of_direction_is_zero():
    bench = Bench().roll(LEFT, FORWARD, 20, 20 * MS).roll(LEFT, BACKWARD, 3, 20 * MS).after(5 * MS)
    speeds = [report.speed for report in wheel_reports(bench) if report.direction == BACKWARD]
    assert speeds == [0, 50, 50]


def test_wheel_reset_zeroes_both_odometers_until_a_wheel_turns_but_keeps_the_ticks():
    # As captured: the tick of the last pulse stays (capture_mixed, 448 and 664) while dist_abs is 0.
    bench = Bench().roll(LEFT, FORWARD, 9, 30 * MS).roll(RIGHT, BACKWARD, 4, 30 * MS)
    before = parse_wheels(bench.after(5 * MS).frames(WHEELS)[-1])
    after = parse_wheels(bench.command(RESET).after(450 * MS).frames(WHEELS)[-1])
    for old, wheel in zip(before, after):
        assert (wheel.speed, wheel.direction, wheel.dist, wheel.dist_abs) == (0, 2, 0, 0)
        assert wheel.when >= old.when > 300
    bench.roll(RIGHT, BACKWARD, 1, 30 * MS).after(10 * MS)
    left, right = parse_wheels(bench.frames(WHEELS)[-1])
    assert (left.direction, left.dist_abs) == (2, 0)
    assert (right.direction, right.dist, right.dist_abs) == (1, 1, 1)


# Each pair is a hall state (pulses modulo 4 of a Gray code 0 1 3 2) and what the first pulses seem to be:
# (direction, dist, dist_abs). The levels are never read at power-up, and an interrupt reads its own pin only.
@pytest.mark.parametrize(
    ("direction", "position", "seen"),
    [
        pytest.param(FORWARD, 0, [(0, 1, 1), (0, 1, 2), (0, 1, 3)], id="forward_from_00_is_right"),
        pytest.param(FORWARD, 1, [(1, 1, 1), (1, 1, 2), (0, 3, 3)], id="forward_from_01_seems_backward_twice"),
        pytest.param(FORWARD, 2, [(2, 0, 1), (2, 0, 2), (0, 3, 3)], id="forward_from_11_has_no_direction_twice"),
        pytest.param(FORWARD, 3, [(2, 0, 1), (0, 2, 2), (0, 2, 3)], id="forward_from_10_has_no_direction_once"),
        pytest.param(BACKWARD, 0, [(1, 1, 1), (1, 1, 2), (1, 1, 3)], id="backward_from_00_is_right"),
        pytest.param(BACKWARD, 3, [(0, 1, 1), (0, 1, 2), (1, 3, 3)], id="backward_from_10_seems_forward_twice"),
        pytest.param(BACKWARD, 2, [(2, 0, 1), (2, 0, 2), (1, 3, 3)], id="backward_from_11_has_no_direction_twice"),
        pytest.param(BACKWARD, 1, [(2, 0, 1), (1, 2, 2), (1, 2, 3)], id="backward_from_01_has_no_direction_once"),
    ],
)
def test_hall_pins_are_taken_for_00_at_power_up(direction, position, seen):
    bench = Bench(wheel_positions=(position, position + 4)).until(300 * MS)
    bench.roll(LEFT, direction, 3, 15 * MS).roll(RIGHT, direction, 3, 15 * MS).after(5 * MS)
    for side in (LEFT, RIGHT):
        reports = [report for report in wheel_reports(bench, side) if report.dist_abs]
        assert [(report.direction, report.dist, report.dist_abs) for report in reports[:2]] == seen[:2]
        assert (reports[-1].direction, reports[-1].dist, reports[-1].dist_abs) == seen[2]


def test_wheel_without_a_direction_has_a_speed():
    # As captured: (0, 2, 311, 0, 1), (66, 2, 326, 0, 2).
    bench = Bench(wheel_positions=(2, 0)).until(300 * MS).roll(LEFT, FORWARD, 2, 15 * MS).after(5 * MS)
    assert [fields(report) for report in wheel_reports(bench)[-2:]] == [(0, 2, 615, 0, 1), (66, 2, 630, 0, 2)]


# Sonars


def sensors_of(frames):
    return [frame[4] for frame in frames]


def sonar_reports(bench):
    return [parse_sonar(frame) for frame in bench.frames(SONAR)]


ECHOES_US = (1456, 4659, 6406, 8153, 9900, 11356)


def near(sensor, at_ns):
    return ECHOES_US[sensor]


def test_sonars_report_in_turn_echo_and_50_ms_and_1_to_2_ms_apart():
    bench = Bench(near).until(20 * S)
    reports = sonar_reports(bench)
    assert sensors_of(bench.frames(SONAR))[:8] == [0, 1, 2, 3, 4, 5, 0, 1]
    for before, after in zip(reports, reports[1:]):
        assert 50 < after.when - before.when - ECHOES_US[after.sensor] / 1000 < 53
    assert len(reports) / 20 == pytest.approx(17, abs=0.6)


def test_13_us_are_taken_off_an_echo():
    for report in sonar_reports(Bench(near).until(3 * S)):
        assert report.echo_us == pytest.approx(ECHOES_US[report.sensor] - 13, abs=1)


def test_echo_s_tick_is_that_of_its_end():
    asked = []

    def echo_us(sensor, at_ns):
        asked.append(at_ns)
        return 6000

    for at_ns, report in zip(asked, sonar_reports(Bench(echo_us).until(500 * MS))):
        assert report.when == 300 + (at_ns + 449_000 + 6_000_000) // MS


@pytest.mark.parametrize(
    ("echo_us", "pulse_end_us", "reported_us"),
    [
        pytest.param(11_600, 38_000, 11_587, id="2_m_are_no_limit"),
        pytest.param(17_471, 38_000, 17_458, id="wall_at_3_m"),
        pytest.param(0, 38_000, 37_987, id="nothing_there"),
        pytest.param(60_000, 38_000, 37_987, id="beyond_the_sensor_s_own_end"),
        pytest.param(0, 200_000, 3_379, id="clone_that_holds_200_ms_wraps_at_16_bits"),
        pytest.param(1, 38_000, 103, id="nothing_nearer_than_2_cm"),
    ],
)
def test_every_echo_is_reported_up_to_the_sensor_s_own_end(echo_us, pulse_end_us, reported_us):
    bench = Bench(lambda sensor, at_ns: echo_us, sonar_pulse_end_us=pulse_end_us).until(2 * S)
    assert {abs(report.echo_us - reported_us) <= 1 for report in sonar_reports(bench)} == {True}


def test_ping_holds_the_loop_up_for_the_0_46_ms_until_the_pin_rises():
    bench = Bench(near).until(300 * MS)
    ping_ns = bench.teensy.next_event_ns
    while not bench.teensy.next_event_ns > bench.now_ns + 300_000:
        ping_ns = bench.teensy.next_event_ns
        bench.until(ping_ns)
    held_until_ns = ping_ns + 449_000
    bench.teensy.wheel_pulse(LEFT, FORWARD, ping_ns + 50_000)
    bench.until(held_until_ns - 1000)
    assert wheel_reports(bench)[-1].dist_abs == 0 and not bench.teensy._transmitter._unsent
    bench.until(held_until_ns + 5 * MS)
    assert wheel_reports(bench)[-1].dist_abs == 1


def held_up_ms(bench, span_s):
    """The longest time that a ping's answer took in this time, ms."""
    worst_ms = 0
    end_ns = bench.now_ns + round(span_s * S)
    while bench.now_ns < end_ns:
        bench.after(3 * MS).fresh(PONG)
        sent_ns = bench.now_ns
        bench.write(framed_for_the_receiver(ping(5)))
        while not bench.after(MS).fresh(PONG):
            pass
        worst_ms = max(worst_ms, (bench.now_ns - sent_ns) / MS)
    return worst_ms


def test_sensor_that_is_missing_later_is_skipped_and_holds_the_loop_up_for_29_ms():
    bench = Bench(near).until(2 * S)
    bench.teensy.set_sonar(3, SONAR_MISSING, bench.now_ns)
    before = len(bench.frames(SONAR))
    bench.after(2 * S)
    assert sensors_of(bench.frames(SONAR)[before + 6 :])[:10] in (
        [0, 1, 2, 4, 5] * 2, [1, 2, 4, 5, 0] * 2, [2, 4, 5, 0, 1] * 2, [4, 5, 0, 1, 2] * 2, [5, 0, 1, 2, 4] * 2,
    )  # fmt: skip
    counters = bench.teensy.counters
    assert counters["pingFail"] == counters["errPing3"] > 4
    assert 25 < held_up_ms(bench, 2.0) < 36
    assert held_up_ms(Bench(near).until(S), 2.0) < 8


def test_sensor_that_is_connected_again_reports_again():
    bench = Bench(near).until(2 * S)
    bench.teensy.set_sonar(3, SONAR_MISSING, bench.now_ns)
    bench.after(S)
    bench.teensy.set_sonar(3, SONAR_FINE, bench.now_ns)
    bench.fresh(SONAR)
    assert set(sensors_of(bench.after(S).fresh(SONAR))) == set(range(6))


def test_two_neighbours_that_are_missing_are_both_skipped():
    bench = Bench(near).until(2 * S)
    for sensor in (2, 3):
        bench.teensy.set_sonar(sensor, SONAR_MISSING, bench.now_ns)
    bench.fresh(SONAR)
    assert set(sensors_of(bench.after(2 * S).fresh(SONAR)[3:])) == {0, 1, 4, 5}


def test_first_sensor_missing_at_power_up_silences_all_six_and_is_tried_once_a_second():
    bench = Bench(near, sonars_missing=(0,)).until(10 * S)
    assert not bench.frames(SONAR)
    assert bench.teensy.counters["errPing0"] == bench.teensy.counters["pingFail"] == 11  # twice at the boot
    bench.teensy.set_sonar(0, SONAR_FINE, bench.now_ns)
    assert len(bench.after(2 * S).frames(SONAR)) > 12


def test_sonar_start_steps_over_a_first_sensor_that_is_missing():
    bench = Bench(near, sonars_missing=(0,)).until(3 * S).command(START).after(2 * S)
    assert sensors_of(bench.frames(SONAR))[:8] == [1, 2, 3, 4, 5, 1, 2, 3]


def test_other_sensor_missing_at_power_up_is_skipped():
    bench = Bench(near, sonars_missing=(4,)).until(3 * S)
    assert sensors_of(bench.frames(SONAR))[:8] == [0, 1, 2, 3, 5, 0, 1, 2]


def test_sensor_that_is_stuck_high_costs_about_the_uptime_and_reports_0():
    # As captured: reports at 832, 2406, 5554 and 11850 ms.
    bench = Bench(near, sonars_missing=())
    bench.teensy.set_sonar(2, SONAR_STUCK, 0)
    bench.until(13 * S)
    stuck = [report for report in sonar_reports(bench) if report.sensor == 2]
    assert [report.echo_us for report in stuck] == [0, 0, 0, 0]
    assert [report.when for report in stuck] == pytest.approx([832, 2406, 5554, 11850], rel=0.02)
    assert sensors_of(bench.frames(SONAR))[:14] == [0, 1, 2, 3, 4, 5, 0, 1, 2, 3, 4, 5, 0, 1]


def test_sensor_that_is_stuck_high_hangs_the_sonars_of_an_old_teensy_until_sonar_start():
    bench = Bench(near, clock_start_ms=180_000).until(S)
    bench.teensy.set_sonar(2, SONAR_STUCK, bench.now_ns)
    bench.after(S)
    bench.fresh(SONAR)
    assert not bench.after(400 * S).fresh(SONAR)
    assert bench.frames(WHEELS)[-1] and len(bench.frames(WHEELS)) > 1900
    bench.command(START).after(20 * S)
    assert sensors_of(bench.fresh(SONAR)) == [3, 4, 5, 0, 1]


def test_sensor_that_is_stuck_high_below_that_uptime_costs_it_once():
    bench = Bench(near, clock_start_ms=177_000).until(S)
    bench.teensy.set_sonar(2, SONAR_STUCK, bench.now_ns)
    bench.after(S)
    bench.fresh(SONAR)
    assert not bench.after(170 * S).fresh(SONAR)
    assert len(bench.after(20 * S).fresh(SONAR)) == 6


def test_sensor_that_lets_go_again_is_heard_again():
    bench = Bench(near, clock_start_ms=180_000).until(S)
    bench.teensy.set_sonar(2, SONAR_STUCK, bench.now_ns)
    bench.after(2 * S)
    bench.teensy.set_sonar(2, SONAR_FINE, bench.now_ns)
    bench.fresh(SONAR)
    assert set(sensors_of(bench.after(S).fresh(SONAR))) == set(range(6))


def started_while(bench, sensor, after_ping_us):
    """Sends SONAR_START so that it is taken so long after a ping with ``sensor``; returns the next three reports."""
    pinged = []
    bench.teensy.echo_us = lambda number, at_ns: pinged.append((number, at_ns)) or ECHOES_US[number]
    wire = framed_for_the_receiver(message(START))
    cycle_ns = 6 * 60 * MS
    bench.after(cycle_ns)
    while not pinged or pinged[-1][0] != sensor:
        bench.after(50_000)
    bench.until(pinged[-1][1] + after_ping_us * 1000 - round(len(wire) * 86_806))
    bench.fresh(SONAR)
    reports = map(parse_sonar, bench.write(wire).after(100 * MS).fresh(SONAR))
    return [(report.sensor, report.echo_us) for report in reports]


def test_sonar_start_while_the_sonars_run_takes_the_present_one_s_echo_for_the_next_one_s():
    # As captured: sensor 2 at 6406 µs reports 4181, its neighbour's 4659 less the 465 µs between the pings and 13.
    reports = started_while(Bench(near).until(S), 1, after_ping_us=30_000)
    assert reports[0] == (2, pytest.approx(4659 - 465 - 13, abs=2))
    assert reports[1] == (3, pytest.approx(ECHOES_US[3] - 13, abs=1))


def test_sonar_start_while_an_echo_is_high_reports_it_below_zero_and_holds_the_loop_up():
    # As captured: 48131 where the echo ended 0.6 ms after the command.
    reports = started_while(Bench(near).until(S), 1, after_ping_us=449 + 4659 - 623)
    sensor, echo_us = reports[0]
    assert sensor == 1 and echo_us == pytest.approx(48_131, abs=60)
    assert reports[1] == (2, pytest.approx(ECHOES_US[2] - 13, abs=1))


def test_sonar_start_whose_next_sensor_hears_first_is_right():
    reports = started_while(Bench(near).until(S), 5, after_ping_us=30_000)
    assert reports[0] == (0, pytest.approx(ECHOES_US[0] - 13, abs=1))


def test_sonars_stopped_are_silent_and_started_go_on():
    bench = Bench(near).until(300 * MS).command(STOP).after(100 * MS)
    bench.fresh(SONAR)
    assert bench.after(2 * S).fresh(SONAR) == []
    assert len(bench.command(START).after(S).fresh(SONAR)) >= 15


def test_sonar_wait_shortens_the_rest():
    bench = Bench(lambda sensor, at_ns: 1000).command(WAIT, struct.pack("<I", 20)).until(100 * MS)
    bench.fresh(SONAR)
    assert len(bench.after(S).fresh(SONAR)) == pytest.approx(1000 / 22.5, abs=2)


@pytest.mark.parametrize("wait_ms", [2**31, 2**32 - 1])
def test_sonar_wait_of_2_to_the_31_and_more_is_none(wait_ms):
    bench = Bench(lambda sensor, at_ns: 5000).command(WAIT, struct.pack("<I", wait_ms)).until(200 * MS)
    bench.fresh(SONAR)
    assert len(bench.after(S).fresh(SONAR)) == pytest.approx(1000 / 5.6, rel=0.05)


def test_new_sonar_wait_counts_only_when_the_one_under_way_is_over():
    bench = Bench(near).until(100 * MS).command(WAIT, struct.pack("<I", 10_000)).after(200 * MS)
    bench.command(WAIT, struct.pack("<I", 50)).fresh(SONAR)
    assert not bench.after(8 * S).fresh(SONAR)
    assert len(bench.after(4 * S).fresh(SONAR)) > 15


def test_sonar_start_ends_a_wait():
    bench = Bench(near).until(100 * MS).command(WAIT, struct.pack("<I", 3_600_000)).after(200 * MS)
    bench.command(WAIT, struct.pack("<I", 50)).fresh(SONAR)
    assert len(bench.command(START).after(2 * S).fresh(SONAR)) > 25


def is_right(report):
    return abs(report.echo_us - ECHOES_US[report.sensor] + 13) <= 1


def test_wrap_of_micros_fails_pings_of_the_last_29_ms_before_it_and_leaves_false_values():
    # micros() wraps 4,294,967.3 ms after power-up: here about 2 s after the start. millis() doesn't.
    fails, false_values = [], []
    for clock_start_ms in range(4_292_900, 4_293_020, 12):
        bench = Bench(near, clock_start_ms=clock_start_ms)
        wrap_ns = (4_294_967 - clock_start_ms) * MS
        assert all(map(is_right, sonar_reports(bench.until(wrap_ns - 40 * MS))))
        assert bench.teensy.counters["pingFail"] == 0
        bench.fresh(SONAR)
        reports = list(map(parse_sonar, bench.until(wrap_ns + 300 * MS).fresh(SONAR)))
        fails.append(bench.teensy.counters["pingFail"])
        false_values.append(sum(not is_right(report) for report in reports))
        assert all(map(is_right, map(parse_sonar, bench.after(3 * S).fresh(SONAR))))
    assert 0 in fails and max(fails) > 5  # some wraps come between two pings
    assert 1 <= max(false_values) <= 10
    assert all(failed or not false for failed, false in zip(fails, false_values))


def test_sonar_filler_is_what_the_packet_held_before():
    bench = Bench(lambda sensor, at_ns: 1000)
    for number in range(60):
        bench.write(framed_for_the_receiver(ping(0xAB00 + number))).after(50 * MS)
    assert {parse_sonar(frame).filler for frame in bench.frames(SONAR)} >= {0, 0xAB}
    garbage = Bench(lambda sensor, at_ns: 1000, seed=1).until(S)
    assert len({parse_sonar(frame).filler for frame in garbage.frames(SONAR)}) > 5


def test_sonar_sequence_set_is_followed():
    bench = Bench(lambda sensor, at_ns: 1000).until(120 * MS).command(SET_SEQ, bytes([3, 0, 1, 5])).after(S)
    bench.fresh(SONAR)
    assert sensors_of(bench.after(330 * MS).fresh(SONAR)) in ([0, 1, 5] * 2, [1, 5, 0] * 2, [5, 0, 1] * 2)


def test_sonar_sequence_of_24_with_repeats_is_followed():
    wanted = [5, 5, 1, 0] * 6
    bench = Bench(lambda sensor, at_ns: 500, sonar_wait_ms=5).command(SET_SEQ, bytes([24, *wanted])).until(2 * S)
    sensors = sensors_of(bench.frames(SONAR))
    assert sensors[6:].count(5) == pytest.approx(len(sensors) / 2, abs=3)


@pytest.mark.parametrize(
    ("payload", "counter", "count"),
    [
        pytest.param(bytes([0]), "badSeqLen", 1, id="empty"),
        pytest.param(bytes([25] + [0] * 25), "badSeqCommand", 1, id="too_long"),
        pytest.param(bytes([4, 0, 6, 255, 1]), "badSonarIdx", 2, id="no_such_sensor"),
    ],
)
def test_bad_sonar_sequence_is_counted(payload, counter, count):
    bench = Bench(lambda sensor, at_ns: 1000).command(SET_SEQ, payload).until(100 * MS)
    assert bench.counters()[counter] == count


def test_sonar_sequence_with_a_bad_entry_keeps_the_old_one_there():
    bench = Bench(lambda sensor, at_ns: 1000).command(SET_SEQ, bytes([3, 5, 6, 4])).until(S)
    assert set(sensors_of(bench.frames(SONAR)[4:])) == {5, 1, 4}


# Restarts, the wrap of millis(), the loop


def test_restart_cuts_the_frame_on_the_line_and_the_boot_frame_s_flag_ends_it():
    bench = Bench(near).until(100 * MS)
    size = len(bench.sent)
    while len(bench.sent) < size + 8:
        bench.after(20_000)
    before = bench.sent
    bench.teensy.reboot(bench.now_ns)
    assert before[-8] == 0x7E and len(before) == size + 8
    assert bench.after(310 * MS).sent[len(before) :].startswith(b"\x7e\xc1\x3e\x7e\x01\x02\x07")


def test_restart_takes_300_ms_and_begins_clock_odometers_and_counters_anew():
    bench = Bench(clock_start_ms=50_000).roll(LEFT, FORWARD, 10, 20 * MS).until(S)
    bench.teensy.reboot(S, off_ns=200 * MS)
    before = len(bench.sent)
    assert bench.until(S + 499 * MS).sent[before:] == b""
    bench.until(S + 520 * MS)
    assert bench.sent[before:].startswith(b"\x7e\xc1\x3e\x7e")
    assert bench.teensy.millis(S + 520 * MS) == 320
    left, _ = parse_wheels(bench.after(10 * MS).frames(WHEELS)[-1])
    assert fields(left) == (0, 2, 0, 0, 0)
    assert bench.teensy.counters["txPackets"] < 8


def test_wheels_turn_uncounted_while_it_boots_but_its_pins_follow_them():
    bench = Bench().until(S).roll(LEFT, FORWARD, 8, 15 * MS)
    bench.teensy.reboot(bench.now_ns)
    bench.roll(LEFT, FORWARD, 17, 15 * MS).after(60 * MS)  # 25 pulses in all: pins 01
    bench.roll(LEFT, FORWARD, 3, 15 * MS).after(5 * MS)
    reports = [(report.direction, report.dist, report.dist_abs) for report in wheel_reports(bench)[-3:]]
    assert reports == [(1, 1, 1), (1, 1, 2), (0, 3, 3)]


def test_bytes_that_come_while_it_boots_are_lost():
    bench = Bench().until(S)
    bench.teensy.reboot(bench.now_ns)
    bench.write(framed_for_the_receiver(ping(1))).after(400 * MS)
    assert not bench.frames(PONG)
    assert bench.write(framed_for_the_receiver(ping(2))).after(10 * MS).frames(PONG)


def test_sonars_begin_with_the_first_of_the_sequence_after_a_restart():
    bench = Bench(near).until(730 * MS)
    bench.teensy.reboot(bench.now_ns)
    bench.fresh(SONAR)
    assert sensors_of(bench.after(S).fresh(SONAR))[:3] == [0, 1, 2]


def test_wrap_of_millis_makes_sonars_hurry_before_it_and_everything_goes_on():
    bench = Bench(near, clock_start_ms=2**32 - 5000).roll(LEFT, FORWARD, 400, 20 * MS)
    whens = [report.when for report in sonar_reports(bench)]
    index = next(i for i, when in enumerate(whens) if when < 2**31)
    hurried = [later - earlier for earlier, later in zip(whens[: index - 1], whens[1:index]) if earlier > 2**32 - 50]
    assert hurried and all(gap <= 12 for gap in hurried)
    assert {later - earlier > 49 for earlier, later in zip(whens[index:], whens[index + 1 :])} == {True}
    newest = wheel_reports(bench.after(5 * MS))[-1]
    assert newest.when == 3000 and newest.speed == 50


def test_check_for_standing_wheels_begins_anew_at_the_wrap_of_millis():
    # As captured: repeats at 201-multiples before it, and at 200 + 201 n after it.
    bench = Bench(clock_start_ms=2**32 - 700).roll(LEFT, FORWARD, 50, 20 * MS).after(3 * S)
    repeats = [report.when for report in wheel_reports(bench) if report.dist_abs == 50][1:]
    assert {(when - 200) % 201 for when in repeats} == {0}


def test_two_failed_pings_without_a_packet_hang_it_until_a_reboot():
    bench = Bench(near, pool_size=2).until(20 * MS)
    bench.teensy.set_sonar(1, SONAR_MISSING, bench.now_ns)
    bench.teensy.set_sonar(2, SONAR_MISSING, bench.now_ns)
    bench.write(b"\x7e")  # the receiver holds a packet now
    bench.teensy._pool.take()
    bench.after(S)
    assert bench.teensy.hung
    size = len(bench.sent)
    bench.teensy.wheel_pulse(LEFT, FORWARD, bench.now_ns)
    assert len(bench.after(S).sent) == size
    bench.teensy.reboot(bench.now_ns)
    bench.after(S)
    assert not bench.teensy.hung and len(bench.sent) > size + 100


# The clock


@pytest.mark.parametrize(
    ("drift_ppm", "ramp_ppm_per_h", "after_1h_ms"),
    [(0, 0, 3_600_000), (40, 0, 3_600_144), (-100, 0, 3_599_640), (0, 20, 3_600_036), (100, -20, 3_600_324)],
)
def test_clock_drifts(drift_ppm, ramp_ppm_per_h, after_1h_ms):
    config = FirmwareConfig(clock_start_ms=0, clock_drift_ppm=drift_ppm, clock_ramp_ppm_per_h=ramp_ppm_per_h)
    teensy = TeensyFirmware(config)
    assert teensy.device_ns(3600 * S) == pytest.approx(after_1h_ms * MS, abs=1000)
    assert teensy.millis(3600 * S) in (after_1h_ms - 1, after_1h_ms)


def test_clock_truncates():
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=10))
    assert [teensy.millis(at_ns) for at_ns in (0, MS - 1, MS, 2 * MS - 1)] == [10, 10, 11, 11]


def test_power_up_later_starts_the_clock_then():
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=5), power_up_ns=1000 * S)
    assert teensy.millis(1000 * S) == 5
    assert teensy.transmit(1000 * S + MS)[:4] == b"\x7e\xc1\x3e\x7e"


def test_time_that_ran_back_changes_nothing():
    bench = Bench(lambda sensor, at_ns: 1000).until(1100 * MS)
    assert bench.teensy.transmit(0) == b""
    bench.teensy.wheel_pulse(LEFT, FORWARD, 0)
    assert parse_wheels(bench.after(10 * MS).frames(WHEELS)[-1])[0].when == 300 + 1100


def test_next_event_is_when_something_happens():
    bench = Bench(lambda sensor, at_ns: 1000).until(20 * MS)
    for _ in range(150):
        bench.until(bench.teensy.next_event_ns)
        assert bench.teensy.next_event_ns > bench.now_ns
    assert bench.now_ns > S


# Configuration


@pytest.mark.parametrize(
    ("name", "value", "accepted"),
    [
        ("baud", 0, "more than 0"),
        ("clock_start_ms", 2**32, r"0 to 2\*\*32 - 1"),
        ("clock_drift_ppm", 1e6, "-10000 to 10000"),
        ("sonar_wait_ms", -1, r"0 to 2\*\*32 - 1"),
        ("loop_us", 0, "1 to 1000"),
        ("sonar_pulse_end_us", 11_000, "more than 11428, up to 1000000"),
        ("sonars_missing", (6,), "sensors from 0 to 5"),
        ("odometer_start", -1, r"0 to 2\*\*32 - 1"),
        ("pool_size", 0, "more than 0"),
        ("uart_buffer", 0, "more than 0"),
        ("boot_byte", 256, "0 to 255"),
        ("sonar_sequence", (0, 6), "1 to 24 sensors from 0 to 5"),
        ("sonar_sequence", (), "1 to 24 sensors from 0 to 5"),
    ],
)
def test_config_that_no_teensy_could_have_is_refused(name, value, accepted):
    with pytest.raises(ConfigError, match=f"{name} is .*; accepted: {accepted}"):
        FirmwareConfig(**{name: value})
