"""Holding a position: past it or as it comes, settled, and measured."""
import pytest

from car_interface.tools.calibration.drive.positions import CROSSED_DUTY, PAST_DUTY, SETTLED_DUTY, Candidate, Hold
from car_interface.tools.calibration.steering.drive import Delay

MS = 1_000_000
LIMITS = (3800.0, 6700.0)


def hold(duty, servo, from_side=0, lag_s=0.15):
    return Hold(Candidate(duty, 1.0, from_side), servo, LIMITS, Delay(0.03, lag_s), 0)


def servo_at(one, servo, until_ns, lag_s=0.15):
    """A servo that follows what is asked, after 30 ms: (where it is, the farthest to each side)."""
    places = [servo]
    for at_ms in range(until_ns // MS):
        servo += (one.asked_duty((at_ms - 30) * MS if at_ms >= 30 else -1) - servo) * (1 / (1000 * lag_s))
        places.append(servo)
    return servo, min(places), max(places)


@pytest.mark.parametrize("servo, from_side", [(6000.0, -1), (4500.0, 1), (5210.0, 0), (5200.0, -1)],
                         ids=("from_the_far_side", "from_the_other_far_side", "from_next_to_it", "from_itself"))
def test_otherwise_it_goes_past_it_and_comes_back(servo, from_side):
    one = hold(5200, servo, from_side)
    assert one.asked_duty(0) == 5200 + one.from_side * PAST_DUTY
    assert one.asked_duty(one.settled_ns) == 5200
    _, low, high = servo_at(one, servo, one.settled_ns)
    farthest = high - 5200 if one.from_side > 0 else 5200 - low
    assert farthest >= CROSSED_DUTY - 8, "the backlash lies to the side that was asked for"


@pytest.mark.parametrize("servo, from_side", [(6700.0, 0), (3800.0, 0), (5210.0, 0), (6000.0, -1)])
@pytest.mark.parametrize("lag_s", [0.03, 0.15, 0.3])
def test_when_it_counts_as_settled_the_servo_has_arrived(servo, from_side, lag_s):
    one = hold(5200, servo, from_side, lag_s)
    assert servo_at(one, servo, one.settled_ns, lag_s)[0] == pytest.approx(5200, abs=SETTLED_DUTY + 1)


def test_only_what_is_driven_while_it_is_settled_counts():
    one = hold(5200, 6000.0)
    one.update_motion(1.0, 0.7, one.settled_ns - 1)
    assert one.length_m == 0.0
    one.update_motion(1.0, 0.5, one.settled_ns)
    one.update_motion(1.0, 0.3, one.settled_ns + MS)
    measured = one.measured()
    assert (measured.duty, measured.from_side, one.length_m) == (5200, 1, 2.0)
    assert measured.curvature_per_m == pytest.approx(0.4)


def test_from_afar_it_is_asked_for_at_once_within_the_limits_and_the_seconds_to_settle_run_down():
    assert hold(3800, 3810.0, -1).asked_duty(0) == 3800
    one = hold(5200, 6000.0)
    assert one.asked_duty(0) == 5200 and one.from_side == 1
    assert one.seconds_to_settle(0) == pytest.approx(one.settled_ns / 1e9)
    assert one.seconds_to_settle(one.settled_ns + MS) == 0.0 and one.is_settled(one.settled_ns)
