"""The pulls of a drive, told apart by what went before and what the car did."""
import numpy as np
import pytest
import virtual_escs

from car_interface.tools.calibration.esc.calibrate import NOTHING_KNOWN, fit
from car_interface.tools.calibration.esc.drive import BACKWARD, HELD, UNCLEAR, pulls, sampled
from car_interface.tools.calibration.shared import Series
from tools.calibration.esc.synthetic import Person


def pulls_of(make, *actions):
    """The pulls after arming and forward: (stick, seconds) each, or None = the center until the car stands."""
    person = Person(make())
    person.center(2.0)
    person.forward()
    for action in actions:
        person.center() if action is None else person.hold(*action)
    person.hold(0, 0.5)
    return pulls(person.recorded())


@pytest.mark.parametrize("make, outcome, pause_s", [
    (virtual_escs.xl5, HELD, None), (virtual_escs.race, HELD, None), (virtual_escs.direct, BACKWARD, 0.0),
    (lambda: virtual_escs.crawler(turn_s=0.1), BACKWARD, 0.1),
    (lambda: virtual_escs.crawler(turn_s=0.3), BACKWARD, 0.3)],
    ids=["xl5", "race", "direct", "crawler", "slow_crawler"])
def test_brake_that_is_held_stops_the_car_or_drives_it_backward_after_a_pause(make, outcome, pause_s):
    (pull,) = pulls_of(make, (-0.5, 2.0))
    assert (pull.outcome, pull.follows_pull, pull.since_forward_s) == (outcome, False, 0.0)
    assert pull.strong_s == pytest.approx(2.0, abs=0.05) and pull.speed_mps > 1.4
    assert pause_s is None or pull.pause_s == pytest.approx(pause_s, abs=0.06)


def test_second_pull_follows_the_first_and_knows_its_neutral_and_that_since_forward():
    first, second = pulls_of(virtual_escs.xl5, (-0.5, 2.0), (0, 0.4), (-0.5, 1.0))
    assert (first.outcome, second.outcome, second.follows_pull) == (HELD, BACKWARD, True)
    assert second.neutral_s == pytest.approx(0.4, abs=0.03) and np.isinf(second.since_forward_s)
    (pull,) = pulls_of(virtual_escs.xl5, None, (0, 3.0), (-0.5, 1.5))
    assert pull.since_forward_s > 3.0 and abs(pull.speed_mps) < 0.05


@pytest.mark.parametrize("push", [0.5, 0.1], ids=["forward", "a_push_within_the_dead_band"])
def test_pull_after_a_push_follows_none(push):
    second = pulls_of(virtual_escs.xl5, (-0.5, 2.0), (0, 0.4), (push, 0.5), (-0.5, 1.5))[1]
    assert not second.follows_pull and (second.since_forward_s == 0) == (push == 0.5)


UNTIL_IT_STANDS = (-0.5, 5.0, lambda speed: speed <= 0)


@pytest.mark.parametrize("actions, outcome", [
    ([(-0.5, 0.3)], UNCLEAR), ([(-0.1, 3.0)], UNCLEAR), ([UNTIL_IT_STANDS, (-0.5, 0.5)], UNCLEAR),
    ([UNTIL_IT_STANDS, (-0.5, 1.2)], HELD),
], ids=["short", "weak", "let_go_soon_after_the_car_stands", "held_on"])
def test_pull_that_shows_nothing_is_unclear(actions, outcome):
    (pull,) = pulls_of(virtual_escs.xl5, *actions)
    assert pull.outcome == outcome


def drive_of(duty_s, duty, end_s):
    """The drive of a car that stands."""
    t_s = np.arange(0.0, end_s, 0.1)
    return sampled(Series(np.array(duty_s), np.array(duty)), Series(t_s, np.zeros(t_s.size)), 4912.0, 6554.0, 3277.0)


def test_pulls_across_a_loss_of_pulses_do_not_belong_together():
    drive = drive_of([0.0, 1.0, 2.0, 2.5, 3.0], [4912, 4096, 4912, np.nan, 4096], 5.0)
    assert [pull.follows_pull for pull in pulls(drive)] == [False, False]


@pytest.mark.parametrize("duty, end_s", [(np.nan, 9.0), (4912.0, 0.3)], ids=["without_a_pulse", "too_short"])
def test_recording_without_a_drive_shows_nothing(duty, end_s):
    found = fit([drive_of([0.0], [duty], end_s)])
    assert (found.values, found.missing) == ({}, [NOTHING_KNOWN])
