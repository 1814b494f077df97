"""The gate for the wheels: what it refuses and why, wrong reports that do no harm, true jumps that are accepted."""

import pytest

from car_interface.teensy.link.protocol import BACKWARD, FORWARD, NO_DIRECTION, Pong, Wheel, WheelStatus
from car_interface.teensy.sensing import plausibility as gates
from car_interface.teensy.sensing.plausibility import Gates
from wheel_reports import (
    LAST,
    NEW,
    NEXT,
    START_MS,
    counted,
    crawl,
    crawled,
    crawling,
    forward,
    judged,
    proven,
    report,
    sonar,
)


def test_reports_of_a_crawl_are_accepted_and_their_pulses_counted():
    verdicts = judged(crawl(5), Gates().wheels)
    assert [verdict.accepted for verdict in verdicts] == [True] * 5
    assert [verdict.reason for verdict in verdicts] == [gates.FIRST, "", "", "", ""]
    assert verdicts[0].restarted and not verdicts[1].restarted
    assert all(verdict.unsplit == (0, 0) for verdict in verdicts)
    assert proven(verdicts) == (4, 4)


@pytest.mark.parametrize("wheel, reason", [
    (NEXT._replace(direction=3), gates.SENSOR_ERROR),
    (NEXT._replace(direction=NO_DIRECTION), gates.COUNTS_DISAGREE),  # though it counted
    (Wheel(0, NO_DIRECTION, 100, 0, 3), gates.COUNTS_DISAGREE),  # a third pulse without a direction
    (NEXT._replace(dist=NEXT.dist_abs + 1), gates.COUNTS_DISAGREE),
    (NEXT._replace(speed=0x1000), gates.SPEED_TOO_HIGH),  # 61 m/s
    (NEXT._replace(dist_abs=LAST.dist_abs - 64), gates.COUNT_BACK),
    (NEXT._replace(when=LAST.when - 64), gates.PULSE_BACK), (LAST._replace(when=LAST.when - 64), gates.PULSE_BACK),
    (LAST._replace(direction=BACKWARD), gates.CHANGE_WITHOUT_PULSE),
    (LAST._replace(dist=2), gates.CHANGE_WITHOUT_PULSE),
    (NEXT._replace(dist_abs=LAST.dist_abs + 256), gates.TOO_MANY_PULSES),  # 80 m/s
    (NEXT._replace(dist_abs=LAST.dist_abs + 32), gates.SURPRISING),  # 10 m/s out of a crawl
    (NEXT._replace(direction=BACKWARD), gates.WRONG_DIRECTION),  # which changes, and dist does not
    (NEXT._replace(dist=3), gates.WRONG_DIRECTION),  # dist moves to the past
])
def test_report_that_can_not_be_is_refused_by_name_and_does_no_harm(wheel, reason):
    for wrong in (report(wheel, NEXT), report(NEXT, wheel)):
        some = crawling()
        verdict = some.wheels(wrong)
        assert (verdict.accepted, verdict.reason, verdict.pulses) == (False, reason, (0, 0))
        assert (some.refused, some.counts[reason]) == (1, 1)
        after = judged(crawled(3), some.wheels)
        assert [verdict.accepted for verdict in after] == [True] * 3
        assert proven(after) == (3, 3)


@pytest.mark.parametrize("speed, is_possible", [(2000, True), (2001, False)])
def test_a_reported_speed_may_be_twice_the_top_speed_and_that_of_a_tick_more(speed, is_possible):
    """Magnets may be near to each other; 500 pulses/s are 10 m/s with a pulse every 2 cm."""
    some = Gates(top_speed_mps=10.0, pulse_m=0.02)
    assert some.wheels(report(NEXT._replace(speed=speed))).accepted == is_possible


def test_two_pulses_in_one_tick_are_a_pulse_in_a_ms():
    fast = [(100, 0), (101, 1), (102, 1), (112, 11)]
    verdicts = judged([report(forward(count, START_MS + later_ms)) for count, later_ms in fast], Gates().wheels)
    assert all(verdict.accepted for verdict in verdicts) and proven(verdicts) == (12, 12)


def test_reversal_at_speed_is_refused_and_after_a_stop_it_is_not():
    fast = [report(forward(100 + 3 * index, LAST.when + 5 * index)) for index in range(10)]  # 9 m/s
    last = fast[-1].left
    for pause_ms, accepted in ((5, False), (200, True)):
        some = Gates()
        judged(fast, some.wheels)
        turned = Wheel(0, BACKWARD, last.when + pause_ms, last.dist_abs + 1, last.dist_abs + 1)
        verdict = some.wheels(report(turned))
        assert verdict.accepted == accepted
        assert verdict.reason == ("" if accepted else gates.REVERSED_AT_SPEED)
        assert verdict.pulses == ((-1, -1) if accepted else (0, 0))


def test_pulse_minutes_ahead_of_the_teensy_s_clock_waits_for_others():
    some = crawling()
    some.sonar(sonar(LAST.when + 20))
    verdict = some.wheels(report(NEXT._replace(when=LAST.when + 2 ** 18), LAST))
    assert (verdict.accepted, verdict.reason) == (False, gates.PULSE_AHEAD)


@pytest.mark.parametrize("ahead_ms, accepted", [(2000, True), (2001, False)])
def test_pulse_may_be_2_s_ahead_of_the_newest_tick(ahead_ms, accepted):
    some = crawling()
    some.sonar(sonar(LAST.when + 20))
    assert some.wheels(report(NEXT._replace(when=LAST.when + 20 + ahead_ms), LAST)).accepted == accepted


def test_wheel_that_stood_for_an_hour_goes_on_at_once():
    some = crawling()
    hour_ms = 3_600_000
    some.sonar(sonar(LAST.when + hour_ms))
    verdicts = judged(crawl(3, LAST.dist_abs + 1, start_ms=LAST.when + hour_ms), some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [True] * 3
    assert proven(verdicts) == (3, 3)


@pytest.mark.parametrize("right, pulses", [
    pytest.param(crawled(2)[1], (-1, 1), id="by_the_next_report"),
    pytest.param(report(NEXT, NEXT._replace(dist_abs=NEXT.dist_abs + 1, when=NEXT.when + 5)), (-2, 1),
                 id="below_what_it_was"),
])
def test_wrong_count_that_was_accepted_is_taken_back(right, pulses):
    some = crawling()
    wrong = some.wheels(report(NEXT._replace(dist_abs=NEXT.dist_abs + 2), NEXT))
    assert (wrong.accepted, wrong.pulses) == (True, (3, 1))
    verdict = some.wheels(right)
    assert (verdict.accepted, verdict.reason, verdict.pulses) == (True, gates.PREVIOUS_WRONG, pulses)


def test_wrong_count_of_many_pulses_is_taken_back_after_three_reports_that_go_with_the_one_before_it():
    some = Gates()
    last = judged([report(forward(100 + 3 * n, LAST.when + 5 * n)) for n in range(10)], some.wheels)
    at = forward(127, LAST.when + 45)
    wrong = some.wheels(report(forward(at.dist_abs + 20, at.when + 40)))  # it fits its 9 m/s, but the car stops
    assert last[-1].accepted and (wrong.accepted, wrong.pulses) == (True, (20, 20))
    verdicts = judged([report(forward(at.dist_abs + n, at.when + 50 * n)) for n in range(2, 6)], some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True]
    assert verdicts[2].reason == gates.PREVIOUS_WRONG and proven([wrong, *verdicts]) == (5, 5)


@pytest.mark.parametrize("wheel", [
    pytest.param(NEXT._replace(dist=NEXT.dist_abs), id="dist_moves_and_direction_does_not"),
    pytest.param(NEXT._replace(when=LAST.when - 1), id="pulse_that_goes_back_by_1_ms"),
])
def test_report_that_goes_with_the_one_before_the_last_is_taken_and_costs_a_pulse_at_most_until_the_next(wheel):
    some = crawling()
    wrong = some.wheels(report(wheel))
    assert (wrong.accepted, wrong.reason) == (True, gates.PREVIOUS_WRONG)
    assert max(wrong.pulses) <= 1
    after = judged(crawled(3), some.wheels)
    assert proven([wrong, *after]) == (3, 3)


def test_wrong_count_that_ended_a_jump_is_taken_back_by_the_next_report():
    some = crawling()
    later = crawl(4, LAST.dist_abs + 40, start_ms=LAST.when + 3000)
    wrong = report(later[2].left._replace(dist_abs=later[2].left.dist_abs + 2))
    verdicts = judged([*later[:2], wrong, later[3]], some.wheels)
    assert [verdict.reason for verdict in verdicts[2:]] == [gates.AFTER_GAP, gates.PREVIOUS_WRONG]
    assert proven(verdicts) == (43, 43)


def test_report_that_may_follow_puts_an_end_to_a_jump_that_nothing_confirmed():
    some = crawling()
    fast = [report(forward(LAST.dist_abs + 6 * n, LAST.when + 5 * n)) for n in range(1, 5)]
    wrong = report(fast[0].left._replace(when=LAST.when - 64))
    verdicts = judged([wrong, *fast[1:]], some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, False, True]
    assert (verdicts[-1].reason, proven(verdicts)) == (gates.AFTER_GAP, (24, 24))


def test_wrong_first_report_is_given_up_after_three_others():
    some = Gates()
    some.wheels(report(forward(2 ** 24, LAST.when)))
    verdicts = judged(crawl(4), some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True]
    assert [verdict.restarted for verdict in verdicts] == [False, False, True, False]
    assert proven(verdicts) == (3, 3)


TRUE_JUMPS = [
    pytest.param(crawl(5, 1, start_ms=LAST.when + 500), 0, True, id="wheel_reset_whose_first_report_was_lost"),
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
    some = crawling(ticks=(LAST.when - 20, LAST.when + 10))  # the clock goes on
    verdict = some.wheels(fresh)
    assert (verdict.accepted, verdict.reason, verdict.pulses) == (True, gates.ODOMETERS_RESET, pulses)
    assert verdict.restarted
    after = some.wheels(WheelStatus(*(
        Wheel(10, FORWARD, NEXT.when + 300, wheel.dist if wheel.direction == FORWARD else wheel.dist_abs + 1,
              wheel.dist_abs + 1) for wheel in fresh)))
    assert (after.accepted, after.pulses) == (True, (1, 1))


def test_first_pulses_of_odometers_at_zero_are_unproven_one_of_each_wheel():
    verdict = crawling().wheels(WheelStatus(Wheel(0, BACKWARD, 302, 1, 1), Wheel(0, NO_DIRECTION, 311, 0, 1)))
    assert (verdict.reason, verdict.pulses) == (gates.ODOMETERS_RESET, (0, 0))
    assert (verdict.unproven, verdict.unsplit) == ((1, 1), (0, 0))


def test_first_pulse_after_a_reset_is_proven_if_the_other_wheel_still_has_the_time_of_its_last_one():
    """No tick has come that could tell a reset from a reboot, after which this time is 0."""
    verdict = crawling().wheels(WheelStatus(forward(1, NEXT.when), NEW._replace(when=LAST.when)))
    assert (verdict.reason, verdict.pulses, verdict.unproven) == (gates.ODOMETERS_RESET, (1, 0), (0, 0))


def test_first_pulse_of_a_wheel_after_a_reset_is_proven_though_the_first_reports_were_lost():
    """The reset keeps the time of its last pulse, and what the firmware knows of its pins."""
    some, stood = crawling(), NEW._replace(when=LAST.when)
    verdicts = judged([WheelStatus(forward(5 + index, NEXT.when + 50 * index), stood) for index in range(3)],
                      some.wheels)
    assert verdicts[-1].reason == gates.ODOMETERS_RESTARTED
    verdict = some.wheels(WheelStatus(forward(8, NEXT.when + 150), forward(1, NEXT.when + 150)))
    assert (verdict.accepted, verdict.pulses, verdict.unproven) == (True, (1, 1), (0, 0))


def test_first_pulse_is_proven_if_the_first_report_is_of_odometers_that_a_reset_has_put_to_zero():
    some, stood = Gates(), NEW._replace(when=LAST.when)
    verdicts = judged([report(stood), WheelStatus(forward(1, NEXT.when), stood)], some.wheels)
    assert (verdicts[1].pulses, verdicts[1].unproven) == ((1, 0), (0, 0))


REST = 201


def standing(count, first=LAST, step_ms=REST):
    """How a standing car repeats itself: both wheels' times are renewed, nothing else."""
    return [report(first._replace(when=first.when + step_ms * n, speed=max(0, 10 - n))) for n in range(1, count + 1)]


def test_repeats_of_a_standing_car_are_accepted_and_add_nothing_and_a_lost_one_shows_in_the_report_after_it():
    some = crawling()
    verdicts = judged(standing(50), some.wheels)
    assert all(verdict.accepted and not verdict.reason for verdict in verdicts)
    assert proven(verdicts) == (0, 0) and some.refused == 0
    left, right = standing(51)[-1]  # is lost
    verdict = some.wheels(WheelStatus(left, right._replace(dist_abs=105, when=left.when + 33)))
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
    some = crawling(ticks=(LAST.when - 20, LAST.when + 10))
    verdicts = judged([BOOT[index] for index in kept], some.wheels)
    assert all(verdict.accepted for verdict in verdicts) and verdicts[0].restarted
    assert tuple(sum(verdict.unproven[side] for verdict in verdicts) for side in (0, 1)) == (2, 2)
    assert proven(verdicts) == (2, 1)


def test_first_pulse_after_power_up_tells_the_reboot_before_any_tick_has_come():
    some = crawling(ticks=(LAST.when - 20, LAST.when + 10))
    verdicts = judged(BOOT[:3], some.wheels)
    assert [verdict.boot_tick for verdict in verdicts] == [None, 311, None]
    assert some.sonar(sonar(330)).reason == "", "the tick gate knows the new clock already"


@pytest.mark.parametrize("uptime_ms, boot_tick", [(1999, None), (2000, 311)])
def test_first_pulse_does_not_tell_the_reboot_of_a_teensy_that_ran_for_less_than_2_s(uptime_ms, boot_tick):
    some = Gates()
    judged(crawl(5, start_ms=1700), some.wheels)
    judged([sonar(uptime_ms - 20), sonar(uptime_ms)], some.sonar)
    assert judged(BOOT[:2], some.wheels)[1].boot_tick == boot_tick


def test_first_pulse_that_a_later_tick_has_overtaken_tells_no_reboot():
    some = crawling(ticks=(LAST.when - 20, LAST.when + 100))
    verdicts = judged([BOOT[0], WheelStatus(Wheel(0, FORWARD, LAST.when + 50, 1, 1), NEW)], some.wheels)
    assert [verdict.boot_tick for verdict in verdicts] == [None, None]


def test_tick_that_goes_back_after_odometers_at_zero_is_a_reboot_at_once():
    some = crawling(ticks=(LAST.when - 20, LAST.when + 10))
    some.wheels(BOOT[0])
    verdict = some.sonar(sonar(303))
    assert (verdict.accepted, verdict.reason, verdict.restarted) == (True, gates.CLOCK_RESTARTED, True)
    assert judged(BOOT[1:3], some.wheels)[0].boot_tick is None
    assert some.refused == 0


def test_car_that_never_moved_was_switched_on_again_if_its_first_pulse_is_older_than_the_clock():
    some = Gates()
    for each in (sonar(START_MS), sonar(START_MS + 30)):
        some.sonar(each)
    judged([BOOT[0]] * 2, some.wheels)
    verdicts = judged(BOOT[1:4], some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True]
    assert verdicts[2].restarted and verdicts[2].since_boot and verdicts[2].boot_tick is not None


def test_car_that_never_moved_was_switched_on_again_if_the_clock_shows_it():
    some = Gates()
    some.sonar(sonar(START_MS))
    judged([BOOT[0]] * 2, some.wheels)
    for later_ms in (0, 50, 100):
        some.sonar(sonar(303 + later_ms))
    verdicts = judged([BOOT[0]] * 2, some.wheels)
    assert [(verdict.accepted, verdict.restarted, verdict.since_boot) for verdict in verdicts] == [
        (True, True, True), (True, False, False)]


def test_first_pulses_of_a_car_that_was_switched_on_again_after_a_reset_are_unproven():
    """It has not moved since the reset, which keeps the time of the last pulse."""
    some = Gates()
    some.sonar(sonar(START_MS))
    some.wheels(report(NEW._replace(when=LAST.when)))
    judged([sonar(303 + later_ms) for later_ms in (0, 50, 100)], some.sonar)
    verdicts = judged(BOOT, some.wheels)
    assert verdicts[0].since_boot
    assert tuple(sum(verdict.unproven[side] for verdict in verdicts) for side in (0, 1)) == (2, 2)


@pytest.mark.parametrize("left, right, pulses, unsplit", [
    ((204, 106), (204, 106), (100, 100), (1, 1)), ((204, 195), (204, 1), (100, 102), (0, 0)),
    ((204, 1), (204, 195), (102, 100), (0, 0)), ((204, 195), (144, 1), (11, 42), (90, 0)),
    ((204, 195), (204, 185), (11, 21), (90, 80)),
], ids=["one_pulse_back_each", "left_wheel_alone_went_back_over_a_magnet", "right_wheel_alone",
        "left_wheel_reversed_somewhere", "both_reversed_somewhere"])
def test_reversals_while_nothing_was_reported_are_settled_by_both_wheels(left, right, pulses, unsplit):
    verdicts = judged([report(*(forward(count + index, START_MS + 5000 + 50 * index, dist)
                                for count, dist in (left, right))) for index in range(3)], crawling().wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True]
    assert (verdicts[-1].pulses, verdicts[-1].unsplit) == (pulses, unsplit)


def test_reversal_of_both_wheels_is_that_of_the_one_that_has_just_reversed_again():
    """Since 104 forward both went back; the left one has just made 10 pulses forward, of 90 + 10."""
    verdicts = judged([WheelStatus(forward(204 + index, START_MS + 5000 + 50 * index, 195),
                                   Wheel(10, BACKWARD, START_MS + 5000 + 50 * index, 105, 204 + index))
                       for index in range(3)], crawling().wheels)
    assert (verdicts[-1].pulses, verdicts[-1].unsplit) == ((-90 + 10 + 2, -102), (0, 0))


def test_first_report_long_after_a_boot_has_all_pulses_since():
    some = crawling(ticks=[START_MS + 200])
    verdicts = judged([report(forward(40 + index, 3000 + 50 * index)) for index in range(3)], some.wheels)
    assert verdicts[-1].since_boot and verdicts[-1].boot_tick == 3100
    assert verdicts[-1].pulses == (40, 40) and verdicts[-1].unproven == (2, 2)


def test_jump_of_counts_that_may_have_gone_on_is_a_reboot_if_the_clock_shows_one():
    some = crawling(ticks=(LAST.when + 10,))
    for later in (0, 50, 100):
        some.pong(Pong(1, LAST.when + 1000 + later), True, reached=LAST.when + 60_000 + later)
    verdicts = judged(crawl(4, LAST.dist_abs + 60, start_ms=LAST.when + 1050), some.wheels)
    assert [verdict.accepted for verdict in verdicts] == [False, False, True, True]
    assert (verdicts[2].reason, verdicts[2].restarted) == (gates.ODOMETERS_RESTARTED, True)
