"""Which changes of the gamepad's requests are logged. Time is passed in."""
from car_interface.common import causes
from car_interface.teleop.gamepad import Requests, RequestsLogFilter

S = 1_000_000_000
MANUAL = Requests(True, 0.0, 0.0, causes.MANUAL, "")
AUTONOMOUS = Requests(True, 0.0, 0.0, causes.AUTONOMOUS, "")
RELEASED = Requests(False, 0.0, 0.0, causes.NO_DEADMAN, "")
STALE = Requests(False, 0.0, 0.0, causes.JOY_STALE, "")
NOT_REARMED = Requests(False, 0.0, 0.0, causes.NOT_REARMED, "")


def logged(*steps):
    """The causes that are logged, of (requests, time in s)."""
    log_filter = RequestsLogFilter()
    return [requests.cause for requests, time_s in steps if log_filter.is_new(requests, round(time_s * S))]


def test_each_cause_is_logged_once_while_it_lasts():
    assert logged((RELEASED, 0), (RELEASED, 0.02), (RELEASED, 80)) == [causes.NO_DEADMAN]
    steps = [(MANUAL, 0), (STALE, 0.25), *((NOT_REARMED, 0.27 + 0.02 * step) for step in range(4000))]
    assert logged(*steps) == [causes.MANUAL, causes.JOY_STALE, causes.NOT_REARMED]


def test_human_who_comes_and_goes_and_each_loss_that_takes_control_away_is_logged():
    steps = [(MANUAL, 0), (RELEASED, 1), (AUTONOMOUS, 2), (MANUAL, 3), (STALE, 4), (MANUAL, 5), (STALE, 6)]
    assert logged(*steps) == [requests.cause for requests, _ in steps]


def test_stick_that_overrides_is_logged_when_it_begins_and_ends():
    overrides = AUTONOMOUS._replace(throttle=-0.5, throttle_stick=causes.OVERRIDE)
    steps = [(AUTONOMOUS, 0), (overrides, 1), (overrides._replace(throttle=-0.7), 1.1), (AUTONOMOUS, 2), (overrides, 3)]
    assert logged(*steps) == [causes.AUTONOMOUS] * 4


def test_gamepad_that_comes_and_goes_without_a_human_is_logged_every_10_s():
    steps = [((STALE, RELEASED)[step % 2], 0.3 * step) for step in range(100)]  # for 30 s
    assert logged(*steps) == [causes.JOY_STALE, causes.NO_DEADMAN] * 3


def test_cause_that_lasts_is_logged_in_the_end():
    steps = [(STALE, 0), (RELEASED, 0.3), (STALE, 0.6), *((STALE, 0.6 + 0.1 * step) for step in range(100))]
    assert logged(*steps) == [causes.JOY_STALE, causes.NO_DEADMAN, causes.JOY_STALE]
