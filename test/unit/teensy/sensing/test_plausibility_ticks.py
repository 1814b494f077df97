"""The gate for the ticks of the Teensy's clock."""

import pytest

from car_interface.teensy.link.protocol import Pong
from car_interface.teensy.sensing import plausibility as gates
from car_interface.teensy.sensing.plausibility import Gates, TickGate
from wheel_reports import judged, sonar


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


def test_wrong_tick_that_was_accepted_is_taken_back_and_is_no_reboot():
    some = Gates()
    judged([sonar(10_000), sonar(10_050), sonar(11_500)], some.sonar)
    verdict = some.sonar(sonar(10_100))
    assert (verdict.accepted, verdict.reason, verdict.restarted) == (True, gates.PREVIOUS_WRONG, False)
    assert some.refused == 0


@pytest.mark.parametrize("ticks, waiting, reason, restarted", [
    pytest.param((30, 80, 130, 180), 2, gates.CLOCK_RESTARTED, True, id="reboot"),
    pytest.param((99_000, 99_050, 99_100, 99_150), 2, gates.AFTER_GAP, False, id="frames_lost_for_a_minute"),
    pytest.param((99_000, 500_000, 500_050, 500_100, 500_150), 3, gates.AFTER_GAP, False, id="one_agrees_with_none"),
])
def test_clock_that_jumped_is_taken_up_with_the_third_consistent_tick(ticks, waiting, reason, restarted):
    some = Gates()
    judged([sonar(10_000), sonar(10_050)], some.sonar)
    verdicts = judged(map(sonar, ticks), some.sonar)
    assert [verdict.accepted for verdict in verdicts] == [False] * waiting + [True] * 2
    assert [(verdict.reason, verdict.restarted) for verdict in verdicts[waiting:]] == [(reason, restarted), ("", False)]


def test_tick_behind_what_the_clock_must_have_reached_is_of_one_that_restarted_though_it_may_follow_the_last():
    some = Gates()
    judged([sonar(10_000), sonar(10_050)], some.sonar)
    verdicts = [some.pong(Pong(1, 10_500 + later), True, reached=60_000 + later) for later in (0, 50, 100)]
    assert [verdict.accepted for verdict in verdicts] == [False, False, True]
    assert (verdicts[2].reason, verdicts[2].restarted) == (gates.CLOCK_RESTARTED, True)


FIRST, FINE, BACK, AHEAD, WRONG = gates.FIRST, "", gates.TICK_BACK, gates.TICK_AHEAD, gates.PREVIOUS_WRONG
REBOOT, GAP = gates.CLOCK_RESTARTED, gates.AFTER_GAP


@pytest.mark.parametrize("ticks, reasons, newest, restarts", [
    # between two ticks are up to 2 s; what was overtaken is up to 0.25 s old, and makes nothing older
    ((10_000, 12_000, 11_750, 14_000), (FIRST, FINE, FINE, FINE), 14_000, 0),
    ((10_000, 12_001), (FIRST, AHEAD), 10_000, 0),
    ((10_000, 9_749), (FIRST, BACK), 10_000, 0),
    # three that agree with each other are the clock, after a reboot or a gap
    ((10_000, 100, 2_100, 1_850, 1_900), (FIRST, BACK, BACK, REBOOT, FINE), 1_900, 1),
    ((10_000, 99_000, 99_050, 99_100, 101_100), (FIRST, AHEAD, AHEAD, GAP, FINE), 101_100, 0),
    ((10_000, 100, 150, 200, 10_000, 10_050, 10_100, 30, 80, 130),
     (FIRST, BACK, BACK, REBOOT, AHEAD, AHEAD, GAP, BACK, BACK, REBOOT), 130, 2),
    # they must come in a row
    ((10_000, 99_000, 99_050, 10_050, 99_100, 99_150), (FIRST, AHEAD, AHEAD, FINE, AHEAD, AHEAD), 10_050, 0),
    ((10_000, 11_500, 99_000, 99_050, 10_050, 99_100, 99_150),
     (FIRST, FINE, AHEAD, AHEAD, WRONG, AHEAD, AHEAD), 10_050, 0),
    # the same tick again, as of two sonars, is not the one before it
    ((10_000, 11_500, 11_500, 10_100), (FIRST, FINE, FINE, WRONG), 10_100, 0),
])
def test_ticks_are_judged_by_the_newest_one(ticks, reasons, newest, restarts):
    gate = TickGate(2000)
    verdicts = [gate.judge(tick) for tick in ticks]
    assert [verdict.reason for verdict in verdicts] == list(reasons)
    assert [verdict.accepted for verdict in verdicts] == [reason not in (BACK, AHEAD) for reason in reasons]
    assert [verdict.restarted for verdict in verdicts] == [reason in (FIRST, REBOOT) for reason in reasons]
    assert (gate.newest, gate.restarts) == (newest, restarts)


def test_after_a_restart_that_is_known_nothing_counts_from_before():
    gate = TickGate(2000)
    for tick in (99_950, 100_000, 9_000, 9_050):
        gate.judge(tick)
    gate.restart(1000)
    assert (gate.newest, gate.restarts) == (1000, 1)
    assert [gate.judge(tick).reason for tick in (9_100, 100_000, 1_050)] == [AHEAD, AHEAD, FINE]


@pytest.mark.parametrize("reached, reason", [(12_500, FINE), (12_501, BACK)])
def test_tick_may_lag_two_seconds_behind_what_the_clock_has_reached(reached, reason):
    gate = TickGate(2000)
    gate.judge(10_000)
    assert gate.judge(10_500, reached).reason == reason


@pytest.mark.parametrize("newest, tick, is_young", [
    (None, 100, False), (10_000, 1_999, True), (10_000, 2_000, False), (1_000, 749, True), (1_000, 750, False),
])
def test_tick_of_the_first_two_seconds_that_nothing_has_overtaken_is_that_of_a_reboot(newest, tick, is_young):
    gate = TickGate(2000)
    if newest is not None:
        gate.judge(newest)
    assert gate.is_young_again(tick) == is_young
