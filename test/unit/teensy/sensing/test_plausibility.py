"""The gates: what they refuse and by which name, that a wrong record does no harm, and that a true jump is taken up."""
from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.sim.teensy_config import FirmwareConfig
from car_interface.sim.teensy_firmware import TeensyFirmware
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.protocol import (
    BACKWARD,
    DIRECTION_ERROR,
    FORWARD,
    NO_DIRECTION,
    UINT32,
    Malformed,
    Pong,
    SonarStatus,
    Wheel,
    WheelStatus,
    decode,
)
from car_interface.teensy.sensing import plausibility as gates
from car_interface.teensy.sensing.plausibility import GateConfig, Gates, ahead, signed_pulses

PULSE_M = math.pi * 0.095 / 20
HARM_M = 0.10
CAPTURE = (Path(__file__).resolve().parents[3] / "data" / "capture_mixed.bin").read_bytes()
NEW = Wheel(0, NO_DIRECTION, 0, 0, 0)
START_MS = 50_000


def forward(pulses, when, dist=1):
    """A wheel that has gone forward all the time."""
    return Wheel(10, FORWARD, when, dist, pulses)


def report(left, right=None):
    return WheelStatus(left, left if right is None else right)


def crawl(count, first=100, step_ms=50, start_ms=START_MS):
    """Reports of a car at 0.3 m/s, a pulse of both wheels in each."""
    return [report(forward(first + index, start_ms + step_ms * index)) for index in range(count)]


def judged(records, judge):
    return [judge(record) for record in records]


def way(verdicts):
    """The pulses of both wheels whose direction is known."""
    return tuple(sum(verdict.pulses[side] for verdict in verdicts) for side in (0, 1))


def counted(verdicts):
    """The pulses of both wheels; those whose direction is not known count forward."""
    return tuple(sum(verdict.pulses[side] + verdict.unproven[side] for verdict in verdicts) for side in (0, 1))


def crawling():
    """Gates that have seen five reports of a crawl; the last one is (104, START_MS + 200)."""
    some = Gates()
    judged(crawl(5), some.wheels)
    return some


def crawled(count):
    """How the crawl goes on."""
    return crawl(5 + count)[5:]


LAST = crawl(5)[-1].left
NEXT = crawl(6)[-1].left


def test_reports_of_a_crawl_are_accepted_and_their_pulses_counted():
    verdicts = judged(crawl(5), Gates().wheels)
    assert [verdict.accepted for verdict in verdicts] == [True] * 5
    assert [verdict.reason for verdict in verdicts] == [gates.FIRST, "", "", "", ""]
    assert verdicts[0].restarted and not verdicts[1].restarted
    assert way(verdicts) == (4, 4)


@pytest.mark.parametrize("wheel, reason", [
    pytest.param(NEXT._replace(direction=DIRECTION_ERROR), gates.SENSOR_ERROR, id="direction_3"),
    pytest.param(NEXT._replace(direction=NO_DIRECTION), gates.COUNTS_DISAGREE, id="no_direction_though_it_counted"),
    pytest.param(Wheel(0, NO_DIRECTION, 100, 0, 3), gates.COUNTS_DISAGREE, id="third_pulse_without_a_direction"),
    pytest.param(NEXT._replace(dist=NEXT.dist_abs + 1), gates.COUNTS_DISAGREE, id="dist_beyond_dist_abs"),
    pytest.param(NEXT._replace(speed=0x1000), gates.SPEED_TOO_HIGH, id="speed_of_61_m_per_s"),
    pytest.param(NEXT._replace(dist_abs=LAST.dist_abs - 64), gates.COUNT_BACK, id="count_goes_back"),
    pytest.param(NEXT._replace(when=LAST.when - 64), gates.PULSE_BACK, id="pulse_goes_back_in_time"),
    pytest.param(LAST._replace(when=LAST.when - 64), gates.PULSE_BACK, id="time_of_the_last_pulse_goes_back"),
    pytest.param(LAST._replace(direction=BACKWARD), gates.CHANGE_WITHOUT_PULSE, id="direction_changes_without_a_pulse"),
    pytest.param(LAST._replace(dist=2), gates.CHANGE_WITHOUT_PULSE, id="dist_changes_without_a_pulse"),
    pytest.param(NEXT._replace(dist_abs=LAST.dist_abs + 256), gates.TOO_MANY_PULSES, id="80_m_per_s"),
    pytest.param(NEXT._replace(dist_abs=LAST.dist_abs + 32), gates.SURPRISING, id="10_m_per_s_out_of_a_crawl"),
    pytest.param(NEXT._replace(direction=BACKWARD), gates.TURNED_WRONGLY, id="direction_changes_and_dist_does_not"),
    pytest.param(NEXT._replace(dist=3), gates.TURNED_WRONGLY, id="dist_moves_to_the_past"),
])
def test_report_that_can_not_be_is_refused_by_name_and_does_no_harm(wheel, reason):
    for wrong in (report(wheel, NEXT), report(NEXT, wheel)):
        some = crawling()
        verdict = some.wheels(wrong)
        assert (verdict.accepted, verdict.reason, verdict.pulses) == (False, reason, (0, 0))
        assert (some.refused, some.counts[reason]) == (1, 1)
        after = judged(crawled(3), some.wheels)
        assert [verdict.accepted for verdict in after] == [True] * 3
        assert way(after) == (3, 3)


def test_reversal_at_speed_is_refused_and_after_a_stop_it_is_not():
    fast = [report(forward(100 + 3 * index, START_MS + 5 * index)) for index in range(10)]  # 9 m/s
    last = fast[-1].left
    for pause_ms, accepted in ((5, False), (200, True)):
        some = Gates()
        judged(fast, some.wheels)
        turned = Wheel(0, BACKWARD, last.when + pause_ms, last.dist_abs + 1, last.dist_abs + 1)
        verdict = some.wheels(report(turned))
        assert verdict.accepted == accepted
        assert verdict.reason == ("" if accepted else gates.TURNED_AT_SPEED)
        assert verdict.pulses == ((-1, -1) if accepted else (0, 0))


def test_wheels_in_opposite_directions_are_a_spinning_car_and_accepted():
    some = Gates()
    spinning = [WheelStatus(*(Wheel(50, direction, START_MS + 20 * n, 1, 3 + n) for direction in (FORWARD, BACKWARD)))
                for n in range(10)]
    verdicts = judged(spinning, some.wheels)
    assert some.refused == 0
    assert way(verdicts) == (9, -9)


def test_pulse_minutes_ahead_of_the_teensy_s_clock_waits_for_others():
    some = crawling()
    some.sonar(SonarStatus(0, 0, LAST.when + 20))
    verdict = some.wheels(report(NEXT._replace(when=LAST.when + 2 ** 18), LAST))
    assert (verdict.accepted, verdict.reason) == (False, gates.PULSE_AHEAD)


def test_wheel_that_stood_for_an_hour_goes_on_at_once():
    some = crawling()
    hour_ms = 3_600_000
    some.sonar(SonarStatus(0, 0, LAST.when + hour_ms))
    verdicts = judged(crawl(3, LAST.dist_abs + 1, start_ms=LAST.when + hour_ms), some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [True] * 3
    assert way(verdicts) == (3, 3)


@pytest.mark.parametrize("bit", range(32))
def test_bit_of_the_count_flipped_moves_a_wheel_by_less_than_10_cm_and_nothing_is_left_of_it(bit):
    for first in (100, 127, 2 ** 20 + 5):
        records = crawl(12, first)
        wrong = records[6].left
        records[6] = report(wrong._replace(dist_abs=wrong.dist_abs ^ 1 << bit), records[6].right)
        some, at, truth = Gates(), 0, first
        for index, record in enumerate(records):
            verdict = some.wheels(record)
            at += verdict.pulses[0]
            truth = first + index
            assert abs(first + at - truth) * PULSE_M < HARM_M or not verdict.accepted
        assert first + at == truth


def test_wrong_count_that_was_accepted_is_taken_back_by_the_next_report():
    some = crawling()
    wrong = some.wheels(report(NEXT._replace(dist_abs=NEXT.dist_abs + 2), NEXT))
    assert (wrong.accepted, wrong.pulses) == (True, (3, 1))
    right = some.wheels(crawled(2)[1])
    assert (right.accepted, right.reason, right.pulses) == (True, gates.TAKEN_BACK, (-1, 1))


def test_wrong_count_is_taken_back_below_what_it_was():
    some = crawling()
    assert some.wheels(report(NEXT._replace(dist_abs=NEXT.dist_abs + 2), NEXT)).pulses == (3, 1)
    again = some.wheels(report(NEXT, NEXT._replace(dist_abs=NEXT.dist_abs + 1, when=NEXT.when + 5)))
    assert (again.accepted, again.reason, again.pulses) == (True, gates.TAKEN_BACK, (-2, 1))


@pytest.mark.parametrize("wheel", [
    pytest.param(NEXT._replace(dist=NEXT.dist_abs), id="dist_moves_and_direction_does_not"),
    pytest.param(NEXT._replace(when=LAST.when - 1), id="pulse_that_goes_back_by_1_ms"),
])
def test_report_that_goes_with_the_one_before_the_last_is_taken_and_costs_a_pulse_at_most_until_the_next(wheel):
    some = crawling()
    wrong = some.wheels(report(wheel))
    assert (wrong.accepted, wrong.reason) == (True, gates.TAKEN_BACK)
    assert max(wrong.pulses) <= 1
    after = judged(crawled(3), some.wheels)
    assert way([wrong, *after]) == (3, 3)


def test_report_that_may_follow_puts_an_end_to_a_jump_that_nothing_confirmed():
    some = crawling()
    fast = [report(forward(LAST.dist_abs + 6 * n, LAST.when + 5 * n)) for n in range(1, 5)]
    wrong = report(fast[0].left._replace(when=LAST.when - 64))
    verdicts = judged([wrong, *fast[1:]], some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, False, True]
    assert (verdicts[-1].reason, way(verdicts)) == (gates.CAUGHT_UP, (24, 24))


def test_wrong_first_report_is_given_up_after_three_others():
    some = Gates()
    some.wheels(report(forward(2 ** 24, START_MS)))
    verdicts = judged(crawl(4), some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True]
    assert [verdict.restarted for verdict in verdicts] == [False, False, True, False]
    assert way(verdicts) == (3, 3)


TRUE_JUMPS = [
    pytest.param(crawl(5, 1, start_ms=START_MS + 700), 0, True, id="wheel_reset_whose_first_report_was_lost"),
    pytest.param(crawl(5, 1, start_ms=300), 0, True, id="reboot_whose_first_reports_were_lost"),
    pytest.param(crawl(5, LAST.dist_abs + 40, start_ms=LAST.when + 3000), 40, False, id="frames_lost_for_3_s"),
    pytest.param(crawl(5, LAST.dist_abs + 400, 5, LAST.when + 1000), 400, False, id="frames_lost_at_6_m_per_s"),
]


@pytest.mark.parametrize("records, unseen, restarted", TRUE_JUMPS)
def test_true_jump_is_taken_up_with_the_third_consistent_report_without_losing_a_pulse(records, unseen, restarted):
    verdicts = judged(records, crawling().wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True, True]
    assert [verdict.restarted for verdict in verdicts] == [False, False, restarted, False, False]
    assert counted(verdicts) == (unseen + 4, unseen + 4)


@pytest.mark.parametrize("fresh, pulses", [
    pytest.param(report(NEW), (0, 0), id="both_at_zero"),
    pytest.param(report(NEW._replace(when=LAST.when)), (0, 0), id="reset_that_keeps_the_time_of_the_last_pulse"),
    pytest.param(report(forward(1, NEXT.when), NEW), (1, 0), id="one_has_made_a_pulse_since"),
    pytest.param(report(NEW, Wheel(0, BACKWARD, NEXT.when, 1, 2)), (0, -2), id="one_has_gone_back_since"),
])
def test_odometers_that_were_reset_are_taken_up_at_once(fresh, pulses):
    some = crawling()
    judged([sonar(tick) for tick in (LAST.when - 20, LAST.when + 10)], some.sonar)  # the clock goes on
    verdict = some.wheels(fresh)
    assert (verdict.accepted, verdict.reason, verdict.pulses) == (True, gates.ODOMETERS_RESET, pulses)
    assert verdict.restarted
    wheels = [wheel._replace(direction=FORWARD, dist=max(1, wheel.dist_abs + 1), dist_abs=wheel.dist_abs + 1,
                             when=NEXT.when + 300) if wheel.direction != FORWARD
              else wheel._replace(dist_abs=wheel.dist_abs + 1, when=NEXT.when + 300) for wheel in fresh]
    after = some.wheels(WheelStatus(*wheels))
    assert (after.accepted, after.pulses) == (True, (1, 1))


def test_counters_that_wrap_are_no_jump():
    some = Gates()
    records = [report(Wheel(10, FORWARD, (UINT32 - 130 + 50 * n) % UINT32, UINT32 - 90, (UINT32 - 3 + n) % UINT32))
               for n in range(8)]
    verdicts = judged(records, some.wheels)
    assert some.refused == 0
    assert way(verdicts) == (7, 7)
    assert [some.sonar(SonarStatus(0, 0, (UINT32 - 100 + 50 * n) % UINT32)).accepted for n in range(6)] == [True] * 6


def sonar(when, echo_us=5000):
    return SonarStatus(1, echo_us, when)


@pytest.mark.parametrize("echo_us", [0, 1, 11_428, 17_458, 37_988, 48_131, 65_535])
def test_any_echo_time_is_let_through_for_the_ranging_to_judge(echo_us):
    assert Gates().sonar(sonar(100, echo_us)).accepted


# --- what only the firmware knows of its wheels ---

REST = 201


def standing(count, first=LAST, step_ms=REST):
    """How a standing car repeats itself: both wheels' times are renewed, nothing else."""
    return [report(first._replace(when=first.when + step_ms * n, speed=max(0, 10 - n))) for n in range(1, count + 1)]


def test_repeats_of_a_standing_car_are_accepted_and_add_nothing():
    some = crawling()
    verdicts = judged(standing(50), some.wheels)
    assert all(verdict.accepted and not verdict.reason for verdict in verdicts)
    assert way(verdicts) == (0, 0) and some.refused == 0


def test_wheel_that_stands_beside_one_that_turns_keeps_its_time_until_both_stand():
    some = crawling()
    turning = [WheelStatus(LAST, forward(104 + n, LAST.when + 30 * n)) for n in range(1, 20)]
    assert way(judged(turning, some.wheels)) == (0, 19)
    both = turning[-1].right.when + REST
    repeat = WheelStatus(LAST._replace(when=both), turning[-1].right._replace(when=both))
    assert some.wheels(repeat).accepted
    assert some.wheels(WheelStatus(repeat.left, repeat.right._replace(dist_abs=124, when=both + 40))).pulses == (0, 1)
    assert some.refused == 0


def test_repeat_that_was_lost_shows_in_the_report_after_it():
    some = crawling()
    repeat = standing(1)[0]
    after = WheelStatus(repeat.left, repeat.right._replace(dist_abs=105, when=repeat.left.when + 33))
    verdict = some.wheels(after)
    assert (verdict.accepted, verdict.reason, verdict.pulses) == (True, "", (0, 1))


def test_repeat_of_one_wheel_alone_can_not_be():
    some = crawling()
    judged(standing(2), some.wheels)
    last = standing(2)[-1]
    verdict = some.wheels(WheelStatus(last.left, last.right._replace(when=last.right.when + 64)))
    assert (verdict.accepted, verdict.reason) == (False, gates.REPEAT_ALONE)
    assert judged(standing(5)[2:], some.wheels)[-1].accepted


def test_setting_off_right_after_a_repeat_is_no_speed():
    """The time since the repeat says nothing about the time since the pulse before."""
    some = crawling()
    judged(standing(3), some.wheels)
    at_ms = LAST.when + 3 * REST + 1
    assert some.wheels(report(forward(105, at_ms))).accepted
    turned = Wheel(0, BACKWARD, at_ms + 30, 106, 106)
    assert (some.wheels(report(turned)).accepted, some.refused) == (True, 0)


# Both wheels rolled on at 1 m/s, as in test/data/firmware: false backward pulses, and pulses without direction.
BOOT = [
    WheelStatus(NEW, NEW),
    WheelStatus(Wheel(0, 1, 302, 1, 1), Wheel(0, 2, 311, 0, 1)),
    WheelStatus(Wheel(66, 1, 317, 1, 2), Wheel(0, 2, 311, 0, 1)),
    WheelStatus(Wheel(66, 1, 317, 1, 2), Wheel(66, 2, 326, 0, 2)),
    WheelStatus(Wheel(0, 0, 332, 3, 3), Wheel(66, 2, 326, 0, 2)),
    WheelStatus(Wheel(0, 0, 332, 3, 3), Wheel(0, 0, 341, 3, 3)),
    WheelStatus(Wheel(66, 0, 347, 3, 4), Wheel(0, 0, 341, 3, 3)),
]


@pytest.mark.parametrize("kept", [range(7), (0, 3, 5, 6), (0, 5, 6)], ids=["all", "half", "most_lost"])
def test_first_two_pulses_of_a_wheel_after_power_up_are_unproven_whatever_the_firmware_says(kept):
    some = crawling()
    judged([sonar(tick) for tick in (LAST.when - 20, LAST.when + 10)], some.sonar)
    verdicts = judged([BOOT[index] for index in kept], some.wheels)
    assert all(verdict.accepted for verdict in verdicts) and verdicts[0].restarted
    assert tuple(sum(verdict.unproven[side] for verdict in verdicts) for side in (0, 1)) == (2, 2)
    assert way(verdicts) == (2, 1)


def test_direction_that_comes_with_the_second_pulse_is_proven():
    some = Gates()
    judged([WheelStatus(NEW, NEW), WheelStatus(Wheel(0, 2, 311, 0, 1), NEW)], some.wheels)
    verdict = some.wheels(WheelStatus(Wheel(0, 0, 326, 2, 2), NEW))
    assert (verdict.pulses, verdict.unproven) == ((1, 0), (0, 0))


def test_first_pulse_after_power_up_tells_the_reboot_before_any_tick_has_come():
    some = crawling()
    judged([sonar(tick) for tick in (LAST.when - 20, LAST.when + 10)], some.sonar)
    verdicts = judged(BOOT[:3], some.wheels)
    assert [verdict.boot_tick for verdict in verdicts] == [None, 311, None]
    assert some.sonar(sonar(330)).reason == "", "the tick gate knows the new clock already"


def test_tick_that_goes_back_after_odometers_at_zero_is_a_reboot_at_once():
    some = crawling()
    judged([sonar(tick) for tick in (LAST.when - 20, LAST.when + 10)], some.sonar)
    some.wheels(BOOT[0])
    verdict = some.sonar(sonar(303))
    assert (verdict.accepted, verdict.reason, verdict.restarted) == (True, gates.CLOCK_RESTARTED, True)
    assert judged(BOOT[1:3], some.wheels)[0].boot_tick is None
    assert some.refused == 0


def test_after_wheel_reset_every_direction_is_proven():
    some = crawling()
    judged([sonar(tick) for tick in (LAST.when - 20, LAST.when + 10)], some.sonar)
    zero = report(NEW._replace(when=LAST.when))
    verdicts = judged([zero, report(forward(1, LAST.when + 50)), report(forward(2, LAST.when + 90))], some.wheels)
    assert way(verdicts) == (2, 2) and not any(any(verdict.unproven) for verdict in verdicts)


def test_first_pulses_of_a_car_that_has_stood_since_power_up_are_unproven_however_long_ago_that_was():
    some = Gates()
    judged([sonar(3_600_000), sonar(3_600_055)], some.sonar)
    first = [report(NEW), report(NEW), report(Wheel(0, BACKWARD, 3_600_100, 1, 1))]
    assert [verdict.unproven for verdict in judged(first, some.wheels)] == [(0, 0), (0, 0), (1, 1)]


def test_pulses_of_a_teensy_that_counts_for_long_are_proven_also_over_a_wrap():
    some = Gates()
    records = [report(Wheel(10, FORWARD, START_MS + 50 * n, UINT32 - 90, (UINT32 - 3 + n) % UINT32)) for n in range(8)]
    assert not any(any(verdict.unproven) for verdict in judged(records, some.wheels))


def test_pong_that_answers_no_ping_is_refused_by_name_and_its_tick_with_it():
    some = Gates()
    some.sonar(sonar(100))
    verdict = some.pong(Pong(1, 2_000_000), is_ours=False)
    assert (verdict.accepted, verdict.reason) == (False, gates.NOT_OUR_PING)
    assert some.sonar(sonar(150)).accepted
    assert some.pong(Pong(1, 160), is_ours=True).accepted


@pytest.mark.parametrize("tick, reason", [
    pytest.param(1000, gates.TICK_BACK, id="tick_going_back"),
    pytest.param(10_000 + 2 ** 16, gates.TICK_AHEAD, id="tick_a_minute_ahead"),
    pytest.param(10_100 + 2 ** 31, gates.TICK_BACK, id="tick_at_the_other_end"),
])
def test_tick_that_can_not_be_is_refused_by_name_and_the_next_is_fine(tick, reason):
    for judge in (Gates.sonar, lambda some, record: some.pong(Pong(7, record.when), is_ours=True)):
        some = Gates()
        judged([sonar(10_000), sonar(10_050)], some.sonar)
        verdict = judge(some, sonar(tick))
        assert (verdict.accepted, verdict.reason) == (False, reason)
        after = some.sonar(sonar(10_100))
        assert (after.accepted, after.reason, after.restarted) == (True, "", False)


def test_pong_that_overtook_a_sonar_s_report_is_nothing_odd():
    some = Gates()
    some.sonar(sonar(10_000))
    assert some.pong(Pong(7, 10_180), is_ours=True).accepted
    late = some.sonar(sonar(10_020))
    assert (late.accepted, late.reason) == (True, "")


def test_wrong_tick_that_was_accepted_is_taken_back_and_is_no_reboot():
    some = Gates()
    judged([sonar(10_000), sonar(10_050), sonar(11_500)], some.sonar)
    verdict = some.sonar(sonar(10_100))
    assert (verdict.accepted, verdict.reason, verdict.restarted) == (True, gates.TAKEN_BACK, False)
    assert some.refused == 0


@pytest.mark.parametrize("start_ms, reason, restarted", [
    pytest.param(30, gates.CLOCK_RESTARTED, True, id="reboot"),
    pytest.param(99_000, gates.CAUGHT_UP, False, id="frames_lost_for_a_minute"),
])
def test_clock_that_jumped_is_taken_up_with_the_third_consistent_tick(start_ms, reason, restarted):
    some = Gates()
    judged([sonar(10_000), sonar(10_050)], some.sonar)
    verdicts = judged([sonar(start_ms + 50 * n) for n in range(4)], some.sonar)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True]
    assert (verdicts[2].reason, verdicts[2].restarted) == (reason, restarted)
    assert (verdicts[3].reason, verdicts[3].restarted) == ("", False)


@pytest.mark.parametrize("name", ["top_speed_mps", "pulse_m", "max_gap_ms"])
@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan])
def test_config_out_of_range_is_refused(name, value):
    with pytest.raises(ConfigError, match=f"^{name} is {value}; accepted: a number above 0$"):
        GateConfig(**{name: value})


@pytest.mark.parametrize("before, now, pulses", [
    pytest.param(forward(5, 0), forward(9, 0), 4, id="forward"),
    pytest.param(Wheel(0, BACKWARD, 0, 3, 5), Wheel(0, BACKWARD, 0, 3, 9), -4, id="backward"),
    pytest.param(forward(5, 0), Wheel(0, BACKWARD, 0, 8, 9), 0, id="two_forward_then_two_back"),
    pytest.param(Wheel(0, BACKWARD, 0, 3, 5), forward(9, 0, 6), 4, id="turns_with_the_next_pulse"),
    pytest.param(forward(5, 0), forward(9, 0, 8), 2, id="turned_round_twice_the_unknown_counts_as_none"),
    pytest.param(NEW, forward(3, 0), 3, id="from_rest"),
    pytest.param(NEW, forward(3, 0, 3), -1, id="from_rest_back_and_then_forward"),
    pytest.param(forward(5, 0), forward(5, 0), 0, id="no_pulse"),
    pytest.param(forward(UINT32 - 2, 0, 7), forward(3, 0, 7), 5, id="wrap"),
])
def test_signed_pulses_between_two_reports(before, now, pulses):
    assert signed_pulses(before, now) == pulses


@given(st.integers(0, UINT32 - 1), st.integers(-2 ** 31, 2 ** 31 - 1))
def test_ahead_is_the_inverse_of_counting_on(counter, step):
    assert ahead((counter + step) % UINT32, counter) == step


def records_of_the_capture():
    return [decode(body) for body in FrameDecoder().feed(CAPTURE)]


def through(some, records):
    """Pulses of both wheels."""
    verdicts = [some.wheels(record) if isinstance(record, WheelStatus)
                else some.sonar(record) if isinstance(record, SonarStatus) else some.pong(record, True)
                for record in records if isinstance(record, (WheelStatus, SonarStatus, Pong))]
    return counted(verdicts)


def test_nothing_of_the_golden_capture_is_refused_and_its_resets_are_seen():
    some = Gates()
    through(some, records_of_the_capture())
    assert (some.refused, some.accepted) == (0, 445 + 218 + 101)
    assert some.counts == {gates.FIRST: 2, gates.ODOMETERS_RESET: 2}


def drive(speeds_mps, seconds_each=1.0):
    """What a Teensy sends while the wheels turn at one speed after another, and the signed pulses that they make."""
    at_ns, position, made = 0, 0.0, 0
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=2 ** 32 - 2000, seed=1), lambda sensor, now_ns: 4000, at_ns)
    data = b""
    speed_mps = 0.0
    step_ns = 200_000
    for wanted_mps in speeds_mps:
        for _ in range(round(seconds_each * 1e9 / step_ns)):
            change = 20.0 * step_ns / 1e9  # m/s²
            speed_mps += max(-change, min(change, wanted_mps - speed_mps))
            at_ns += step_ns
            position += speed_mps * step_ns / 1e9 / PULSE_M
            while abs(position - made) >= 1:
                direction = FORWARD if position > made else BACKWARD
                made += 1 if direction == FORWARD else -1
                for side in (0, 1):
                    teensy.wheel_pulse(side, direction, at_ns)
            if at_ns % 1_000_000 == 0:
                data += teensy.transmit(at_ns)
    return data, made


@pytest.mark.parametrize("speeds_mps", [
    pytest.param([0.0, 0.05, 0.05, 0.0], id="crawl_of_5_cm_per_s"),
    pytest.param([0.0, 8.0, 0.0, 8.0, 0.0], id="stop_and_go"),
    pytest.param([0.0, 2.0, -2.0, 2.0, -2.0, 0.0], id="reversing"),
    pytest.param([0.0, 14.0, 14.0, 0.0, 0.0], id="50_km_per_h"),
    pytest.param([0.0, 19.0, 19.0, 0.0, 0.0], id="almost_the_top_speed"),
])
def test_nothing_of_a_clean_drive_is_refused_and_each_pulse_counts(speeds_mps):
    data, made = drive(speeds_mps)
    some = Gates()
    assert through(some, [decode(body) for body in FrameDecoder().feed(data)]) == (made, made)
    assert some.refused == 0


@given(st.lists(st.integers(0, 3), min_size=30, max_size=200))
def test_reports_lost_anywhere_cost_no_pulse_once_three_have_come(kept):
    records = crawl(len(kept) + 3)
    heard = [record for record, keep in zip(records, [*kept, 1, 1, 1]) if keep]
    verdicts = judged(heard, Gates().wheels)
    first = heard[0].left.dist_abs
    assert first + way(verdicts)[0] == records[-1].left.dist_abs


WHEELS = st.builds(Wheel, st.integers(0, 65535), st.integers(0, 3), st.integers(0, UINT32 - 1),
                   st.integers(0, UINT32 - 1), st.integers(0, UINT32 - 1))
SMALL_WHEELS = st.builds(Wheel, st.integers(0, 40), st.integers(0, 3), st.integers(0, 400), st.integers(0, 9),
                         st.integers(0, 9))
REPORTS = st.builds(WheelStatus, WHEELS | SMALL_WHEELS, WHEELS | SMALL_WHEELS)


@given(st.lists(REPORTS, max_size=30))
def test_gates_fed_anything_answer_and_take_up_a_crawl_after_at_most_three_reports(junk):
    some = Gates()
    judged(junk, some.wheels)
    verdicts = judged(crawl(6, 2 ** 30, start_ms=2 ** 30), some.wheels)
    assert [verdict.accepted for verdict in verdicts[2:]] == [True] * 4
    assert way(verdicts[3:]) == (3, 3)


def wheel_bodies(data):
    return [body for body in FrameDecoder().feed(data) if isinstance(decode(body), WheelStatus)]


@pytest.mark.parametrize("bodies", [
    pytest.param(wheel_bodies(CAPTURE)[60:70], id="capture_at_0.3_m_per_s"),
    pytest.param(wheel_bodies(drive([8.0, 8.0])[0])[-60:-50], id="8_m_per_s"),
    pytest.param(wheel_bodies(drive([19.0, 19.0])[0])[-60:-50], id="19_m_per_s"),
    pytest.param(wheel_bodies(drive([-2.0, 2.0, 2.0])[0])[-60:-50], id="2_m_per_s_after_a_reversal"),
])
def test_any_two_flips_that_the_checksum_can_not_see_move_no_wheel_by_10_cm(bodies):
    """Exhaustive over the pairs of one column that differ, in a report with others around it; nothing is left of it."""
    for index in (4, 5):
        body = bodies[index]
        for bit in range(8):
            ones = [place for place in range(4, 36) if body[place] >> bit & 1]
            zeros = [place for place in range(4, 36) if not body[place] >> bit & 1]
            for one in ones:
                for zero in zeros:
                    wrong = bytearray(body)
                    wrong[one] ^= 1 << bit
                    wrong[zero] ^= 1 << bit
                    check_harm([*bodies[:index], bytes(wrong), *bodies[index + 1:]], bodies)


def check_harm(bodies, truth):
    some, moved, first = Gates(), (0, 0), decode(truth[0])
    for body, meant in zip(bodies, truth):
        record, right = decode(body), decode(meant)
        true = tuple(map(signed_pulses, first, right))
        if isinstance(record, Malformed):
            continue
        verdict = some.wheels(record)
        moved = tuple(map(sum, zip(moved, verdict.pulses)))
        if verdict.accepted:
            assert max(abs(have - meant) for have, meant in zip(moved, true)) * PULSE_M < HARM_M, (record, right)
    assert moved == true, decode(truth[0])
