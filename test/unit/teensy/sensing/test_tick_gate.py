"""The gate for the ticks of the Teensy's clock."""

import pytest

from car_interface.teensy.link.protocol import Pong
from car_interface.teensy.sensing import verdicts as gates
from car_interface.teensy.sensing.plausibility import Gates
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
