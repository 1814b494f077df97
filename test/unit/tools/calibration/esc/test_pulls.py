"""The pulls of a drive, told apart by what went before and what the car did."""
import numpy as np
import pytest
import virtual_escs

from car_interface.tools.calibration.esc.pulls import BACKWARD, HELD, UNCLEAR, EscDrive, pulls, sampled
from tools.calibration.esc.synthetic import Person


def pulls_of(make, *actions):
    """The pulls after arming and forward: (stick, seconds) each, or None = the center until the car stands."""
    person = Person(make())
    person.center(2.0)
    person.forward()
    for action in actions:
        person.center() if action is None else person.hold(*action)
    person.hold(0, 0.5)
    return pulls(sampled(person.recorded()))


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


def test_pulls_across_a_loss_of_pulses_do_not_belong_together():
    drive = EscDrive(np.array([0.0, 1.0, 2.0, 2.5, 3.0]), np.array([4912, 4096, 4912, 0, 4096]),
                     np.array([0.0, 5.0]), np.array([0.0, 0.0]), 4912.0, 6554.0, 3277.0)
    assert [pull.follows_pull for pull in pulls(sampled(drive))] == [False, False]


@pytest.mark.parametrize("drive", [
    EscDrive(*[np.zeros(0)] * 4, 4912.0, 6554.0, 3277.0),
    EscDrive(np.zeros(1), np.zeros(1), np.array([0.0, 9.0]), np.zeros(2), 4912.0, 6554.0, 3277.0),
    EscDrive(np.zeros(1), np.full(1, 4912.0), np.array([0.0, 0.1]), np.zeros(2), 4912.0, 6554.0, 3277.0),
], ids=["empty", "without_a_pulse", "too_short"])
def test_recording_without_a_drive_is_none(drive):
    assert sampled(drive) is None
