"""The simulated Teensy's sonars, specified as rules; test_captures.py holds them against captures of the original."""
import struct

import pytest

from teensy_bench import MS, SET_SEQ, SONAR, WAIT, Bench, S, framed_for_the_receiver, parse_sonar, ping


@pytest.mark.parametrize(("echo_us", "pulse_end_us", "reported_us"), [
    pytest.param(11_600, 38_000, 11_587, id="2_m_are_no_limit"),
    pytest.param(17_471, 38_000, 17_458, id="wall_at_3_m"),
    pytest.param(0, 38_000, 37_987, id="nothing_there"),
    pytest.param(60_000, 38_000, 37_987, id="beyond_the_sensor_s_own_end"),
    pytest.param(0, 200_000, 3_379, id="clone_that_holds_200_ms_wraps_at_16_bits"),
    pytest.param(1, 38_000, 103, id="nothing_nearer_than_2_cm"),
])
def test_every_echo_is_reported_up_to_the_sensor_s_own_end(echo_us, pulse_end_us, reported_us):
    bench = Bench(lambda sensor, at_ns: echo_us, sonar_pulse_end_us=pulse_end_us).until(2 * S)
    assert {abs(parse_sonar(frame).echo_us - reported_us) <= 1 for frame in bench.frames(SONAR)} == {True}


@pytest.mark.parametrize(("wait_ms", "echo_us", "period_ms"), [(20, 1000, 22.5), (2**31, 5000, 5.6)])
def test_sonar_wait_shortens_the_rest_and_one_of_2_to_the_31_is_none(wait_ms, echo_us, period_ms):
    bench = Bench(lambda sensor, at_ns: echo_us).command(WAIT, struct.pack("<I", wait_ms)).until(200 * MS)
    before = len(bench.frames(SONAR))
    assert len(bench.after(S).frames(SONAR)) - before == pytest.approx(1000 / period_ms, rel=0.05)


def test_sonar_filler_is_what_the_packet_held_before():
    bench = Bench(lambda sensor, at_ns: 1000)
    for number in range(60):
        bench.write(framed_for_the_receiver(ping(0xAB00 + number))).after(50 * MS)
    assert {parse_sonar(frame).filler for frame in bench.frames(SONAR)} >= {0, 0xAB}
    garbage = Bench(lambda sensor, at_ns: 1000, seed=1).until(S)
    assert len({parse_sonar(frame).filler for frame in garbage.frames(SONAR)}) > 5


@pytest.mark.parametrize(("sequence", "followed"), [
    ([0, 1, 5], [0, 1, 5]), ([5, 5, 1, 0] * 6, [5, 5, 1, 0] * 6), ([5, 6, 4], [5, 1, 4])],
    ids=["three", "24_with_repeats", "a_bad_entry_keeps_the_old_one_there"])
def test_sonar_sequence_set_is_followed(sequence, followed):
    bench = Bench(lambda sensor, at_ns: 500).command(WAIT, struct.pack("<I", 5)).until(120 * MS)
    bench.command(SET_SEQ, bytes([len(sequence), *sequence])).after(S)
    sensors = [parse_sonar(frame).sensor for frame in bench.frames(SONAR)][-2 * len(followed):]
    assert sensors in [(2 * (followed[start:] + followed[:start])) for start in range(len(followed))]


@pytest.mark.parametrize(("payload", "counter", "count"), [
    (bytes([0]), "badSeqLen", 1), (bytes([25] + [0] * 25), "badSeqCommand", 1),
    (bytes([4, 0, 6, 255, 1]), "badSonarIdx", 2)], ids=["empty", "too_long", "no_such_sensor"])
def test_bad_sonar_sequence_is_counted(payload, counter, count):
    bench = Bench(lambda sensor, at_ns: 1000).command(SET_SEQ, payload).until(100 * MS)
    assert bench.teensy.counters[counter] == count


def test_pin_that_blinks_holds_the_others_up_and_its_length_is_reported_in_16_bits():
    bench = Bench(lambda sensor, at_ns: 5000).until(5 * S)
    bench.teensy.set_sonar(2, "blink", 5 * S)
    reports = [parse_sonar(frame) for frame in bench.after(3 * S).frames(SONAR)]
    gaps_ms = [(after.when - before.when - after.echo_us / 1000, after.sensor)
               for before, after in zip(reports, reports[1:])]
    (gap_ms, sensor), *others = sorted(gaps_ms, reverse=True)
    assert sensor == 2 and 1100 < gap_ms < 2100 and others[0][0] < 53
    assert [report.sensor for report in reports[-6:]] in [[*range(n, 6), *range(n)] for n in range(6)]
    assert {report.echo_us for report in reports[-6:]} == {5000 - 13}


def test_one_sensor_may_be_a_clone_until_it_is_fine_again():
    bench = Bench(lambda sensor, at_ns: 0).until(S)
    for condition, echo_us in (("clone", 3_379), ("fine", 37_987)):
        before = len(bench.after(S).frames(SONAR))
        bench.teensy.set_sonar(4, condition, bench.now_ns)
        bench.after(2 * S)
        found = {frame.sensor: frame.echo_us for frame in map(parse_sonar, bench.frames(SONAR)[before + 6:])}
        assert all(abs(found[sensor] - (echo_us if sensor == 4 else 37_987)) <= 1 for sensor in range(6))
