"""The simulated Teensy's sonars, specified as rules; test_captures.py holds them against captures of the original."""
import struct

import pytest

from car_interface.sim.teensy_sonars import SONAR_FINE, SONAR_MISSING, SONAR_STUCK
from teensy_bench import (
    ECHOES_US,
    MS,
    PONG,
    SET_SEQ,
    SONAR,
    START,
    STOP,
    WAIT,
    WHEELS,
    Bench,
    S,
    framed_for_the_receiver,
    near,
    parse_sonar,
    ping,
    sensors_of,
    sonar_reports,
)


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


def test_other_sensor_missing_at_power_up_is_skipped():
    bench = Bench(near, sonars_missing=(4,)).until(3 * S)
    assert sensors_of(bench.frames(SONAR))[:8] == [0, 1, 2, 3, 5, 0, 1, 2]


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
