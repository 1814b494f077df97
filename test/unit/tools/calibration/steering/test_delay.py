"""How long an effect takes to follow its cause, whatever the curve between them."""
import numpy as np
import pytest

from car_interface.tools.calibration.shared import held
from car_interface.tools.calibration.steering.drive import STEP_S, estimate_delay, lagged


def a_drive(delay_s, lag_s, curve, noise, seed=1):
    """Commands that step now and then, and what comes of them 50 times a second."""
    rng = np.random.default_rng(seed)
    steps_s = np.cumsum(rng.uniform(0.3, 3.0, 80))
    duty = rng.uniform(3800, 6600, 80)
    at_s = np.arange(steps_s[0], steps_s[-1], STEP_S)
    effect = curve(lagged(held(steps_s, duty, at_s - delay_s), STEP_S, lag_s))
    return steps_s, duty, at_s, effect + noise * rng.standard_normal(len(at_s)), np.ones(len(at_s))


@pytest.mark.parametrize("curve", (
    lambda duty: (5200 - duty) / 1400,
    lambda duty: np.sign(5200 - duty) * np.abs((5200 - duty) / 1400) ** 3,
    lambda duty: np.tanh((duty - 5200) / 300),
), ids=("straight", "steep at its ends", "saturated, the other way round"))
@pytest.mark.parametrize("delay_s, lag_s", ((0.2, 0.05), (0.0, 0.15)))
def test_delay_and_lag_are_found_without_knowing_the_curve(curve, delay_s, lag_s):
    found = estimate_delay(*a_drive(delay_s, lag_s, curve, noise=0.05))
    assert found.delay_s + found.lag_s == pytest.approx(delay_s + lag_s, abs=0.03)
    assert found.delay_s == pytest.approx(delay_s, abs=0.04)


def test_effect_that_has_nothing_to_do_with_the_cause_has_no_delay():
    steps_s, duty, at_s, effect, weight = a_drive(0.1, 0.1, lambda duty: 0.0 * duty, noise=1.0)
    assert estimate_delay(steps_s, duty, at_s, effect, weight) is None


@pytest.mark.parametrize("change", (
    lambda s, d, t, e, w: (s, d, t, e, 0 * w),
    lambda s, d, t, e, w: (s, 0 * d, t, e, w),
    lambda s, d, t, e, w: (s[:0], d[:0], t, e, w),
    lambda s, d, t, e, w: (s, d, t[:50], e[:50], w[:50]),
), ids=("no weight", "a cause that never changes", "no cause", "a second"))
def test_too_little_to_tell_has_no_delay(change):
    assert estimate_delay(*change(*a_drive(0.1, 0.1, lambda duty: duty, noise=0.0))) is None


def test_held_signal_keeps_its_value_and_a_lagged_step_has_done_63_percent_after_its_lag():
    t_s, value = np.array([1.0, 2.0]), np.array([10.0, 20.0])
    assert held(t_s, value, np.array([0.0, 1.0, 1.99, 2.0, 9.0])).tolist() == [10, 10, 10, 20, 20]
    step = np.concatenate([np.zeros(1), np.ones(500)])
    assert lagged(step, 0.001, 0.1)[100] == pytest.approx(1 - np.exp(-1), abs=0.01)
    assert lagged(step, 0.001, 0.0) is not None and lagged(step, 0.001, 0.0).tolist() == step.tolist()
