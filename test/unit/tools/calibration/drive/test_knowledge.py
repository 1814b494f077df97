"""What a fit of the samples so far knows, and where it knows least."""
import numpy as np
import pytest

from car_interface.tools.calibration.drive.knowledge import assess
from car_interface.tools.calibration.steering.drive import COUNT, NOTHING_GIVEN, CurveFitConfig
from tools.calibration.drive.light_car import base
from tools.calibration.steering.synthetic import drive, from_both_sides, mixed, true_curvature

pytestmark = pytest.mark.once
CONFIG = CurveFitConfig(limits=(base().servo_left, base().servo_right))


def known(duties, config=CONFIG):
    return assess(drive(duties), config)


@pytest.fixture(scope="module")
def full():
    return known(mixed(3900, 6400))


def test_a_drive_all_over_is_known_within_what_the_tool_allows(full):
    assert (full.reason, full.missing) == ("", ())
    assert max(full.errors) < 1 and full.center_duty == pytest.approx(5200, abs=10)
    assert np.allclose(full.curvatures, true_curvature(full.duties), atol=0.02)
    assert not (full.duties % COUNT).any()
    assert [*full.points] == ["left", "right"] and all(one.is_known for side in full.points.values() for one in side)
    assert len(full.needs) == len(full.duties)
    assert (full.needs >= full.errors).all(), "more than the tool asks for"


def test_a_gap_is_to_be_measured_sooner_than_the_tool_asks_for_it():
    places = [duty for duty in mixed(3900, 6400) if not 4500 < duty < 4800]
    found = known(from_both_sides(places))
    found = {duty: (error, need) for duty, error, need in zip(found.duties, found.errors, found.needs)}
    (error, need), (_, next_to_it) = found[4640], found[4496]
    assert need > 1.5 * error and need > 2 * next_to_it


def test_with_delay_and_backlash_given_it_is_the_same_curve_with_the_same_errors(full):
    quick = known(mixed(3900, 6400), full.given)
    assert np.allclose(quick.curvatures, full.curvatures, atol=1e-6)
    assert full.given.backlash_sigma > 0 and full.given.limits == CONFIG.limits
    assert np.allclose(quick.errors, full.errors, atol=1e-6)


@pytest.mark.parametrize("duties", [[5200], [5200, 5216, 5200], [3900, 3950, 4000, 4050, 4100]],
                         ids=("one", "nearly_one", "one_side"))
def test_without_a_curve_there_is_a_reason(duties):
    found = known(duties)
    assert found.reason and not found.duties.size
    empty = drive([5200])._replace(**{name: np.zeros(0) for name in drive([5200])._fields})
    assert assess(empty, NOTHING_GIVEN).reason, "without samples"
