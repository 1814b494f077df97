"""Where to hold the stick, and for how long still."""
import pytest

from car_interface.tools.calibration.drive.calibration_drive import StickGuide
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.survey import DONE, MEASURING, PAUSED, SETTLING
from tools.calibration.drive.light_car import LightCar, base

pytestmark = pytest.mark.once


def car(**options):
    return LightCar(StickGuide(base(), CalibrationDriveConfig(**options)), fits=options.pop("fits", True))


def obey(one, seconds, off_duty=0, speed_mps=1.0, until=lambda guidance: False):
    """A person who does what the guide says, and comes to a position from its side."""
    guidance = one.tick(speed_mps, 5184)
    for _ in range(round(50 * seconds)):
        duty = guidance.target_duty + off_duty
        if guidance.text.startswith("push to"):
            duty += 90 * (1 if _side(guidance) > 0 else -1)
        guidance = one.tick(speed_mps, duty)
        if until(guidance):
            break
    return guidance


def _side(guidance):
    """The side in duty on which the guide wants the stick first, by its words."""
    past, back = guidance.text.split("first, then come back to")
    return _number(back) - _number(past.replace("push to", ""))


def _number(words):
    words = words.strip()
    if words == "the middle":
        return 0.0
    value = float(words.split("%")[0])
    return value if words.endswith("left") else -value


def test_it_waits_for_odometry_says_how_long_still_and_then_the_next_until_it_is_ended_by_hand():
    one = car()
    assert "odom was never heard" in one.drive.step(1, "").text
    guidance = obey(one, 3, until=lambda guidance: guidance.phase == MEASURING)
    assert guidance.text == "hold 100% left: 2 s more at this speed"
    assert guidance.held == pytest.approx(1.0)
    for _ in range(50):
        shorter = one.tick(1.0, 3900)
    assert shorter.text == "hold 100% left: 1 s more at this speed"
    assert obey(one, 5, until=lambda guidance: guidance.target_duty != 3900).target_duty == 6400
    one.drive.finish()
    assert one.tick(1.0, 5184).phase == DONE


def test_the_center_is_come_to_past_one_side():
    one = car()
    guidance = obey(one, 30, until=lambda guidance: guidance.text.startswith("push to"))
    assert guidance.phase == SETTLING and guidance.text.endswith("then come back to the middle")
    assert guidance.target_duty == 5184


def test_a_stick_that_wanders_is_not_held_and_too_fast_is_said():
    one = car()
    for tick in range(200):
        guidance = one.tick(1.0, 3900 + (tick % 20) * 10)
    assert guidance.phase == SETTLING and guidance.text == "hold the stick still at 100% left"
    for _ in range(100):
        guidance = one.tick(2.5, 3900)
    assert guidance.phase == PAUSED and guidance.text == "slower: at this speed tyres may slide"


@pytest.mark.parametrize("duties", [(3904, 3920), (3916, 3916)], ids=("trembles", "next_to_the_position"))
def test_a_thumb_that_trembles_between_two_counts_holds_the_stick_still(duties):
    one = car()
    phases = {one.tick(1.0, duties[tick // 5 % 2]).phase for tick in range(150)}
    assert MEASURING in phases


def test_a_person_who_obeys_gets_all_of_it():
    one = car(max_time_s=60.0)
    guidance = obey(one, 80, until=lambda guidance: guidance.phase == DONE)
    assert guidance.phase == DONE
    progress = one.drive.progress()
    assert progress.positions >= 20 and progress.known.center_duty == pytest.approx(5200, abs=5)
    assert progress.known.missing == ()
