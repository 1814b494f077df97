"""An ESC told by a drive: right, or refused with what to drive; never wrong."""
import os
from types import SimpleNamespace

import numpy as np
import pytest
import virtual_escs
from esc_car import EscCarConfig

from car_interface.sim import drive_train as virtual
from car_interface.throttle.esc_config import EscConfig
from car_interface.tools.calibration.esc import calibrate
from tools.calibration.esc.synthetic import FULL_FORWARD, FULL_REVERSE, Person, random_esc

RANDOM_ESCS = 200 if os.environ.get("CAR_INTERFACE_ALL") else 10


FIELDS = {declaration.name: name for name, declaration in zip(calibrate.FIELDS, calibrate.PARAMETERS)}


def fit(*drives):
    """What drives show, by the names of the configuration's fields; None = they don't."""
    found = calibrate.fit(drives)
    values = {FIELDS.get(name, name.split("/")[1]): value for name, value in found.values.items()}
    return SimpleNamespace(**{**dict.fromkeys((*FIELDS.values(), "neutral")), **values}, seen=found.seen,
                           missing=found.missing)


def fitted(make, seed=1, **changes):
    return fit(Person(make(**changes), seed=seed).drive())


@pytest.mark.once
def test_random_escs_are_told_right_or_refused():
    right = 0
    for seed in range(RANDOM_ESCS):
        esc, car = random_esc(seed)
        found = fit(Person(esc, car, seed).drive())
        assert found.profile in (esc.kind, None), f"seed {seed}: {found}"
        right += found.profile == esc.kind
        _assert_numbers_are_true(found, esc, f"seed {seed}: {found}")
        _assert_it_is_a_configuration(found)
    assert right >= 0.75 * RANDOM_ESCS


def _assert_numbers_are_true(found, esc, text):
    low, high = esc.neutral_duty - esc.reverse_band_duty, esc.neutral_duty + esc.forward_band_duty
    if found.neutral is not None:
        assert low < found.neutral < high, text
        assert found.neutral + found.dead_band_forward * (FULL_FORWARD - found.neutral) >= high, text
        assert found.neutral - found.dead_band_reverse * (found.neutral - FULL_REVERSE) <= low, text
    if found.dwell_s is not None:
        assert esc.dwell_s - 0.02 <= found.dwell_s <= esc.dwell_s + 0.15, text
    if found.reverse_after_neutral_s is not None:
        forget_s = esc.forget_s or np.inf
        assert (found.reverse_after_neutral_s or 60) <= forget_s or not esc.forget_s, text
        assert bool(found.reverse_after_neutral_s) == bool(esc.forget_s), text


def _assert_it_is_a_configuration(found):
    if found.profile:
        values = {name: getattr(found, name) for name in calibrate.FIELDS if getattr(found, name) is not None}
        assert EscConfig(**values, profile_measured=True, stop_brake=0.5).profile == found.profile


def test_esc_without_reverse_is_not_asked_for_its_neutral_and_its_drag_brake_is_told():
    found = fitted(virtual_escs.race, drag_brake=0.3)
    assert (found.profile, found.neutral, found.dead_band_reverse, found.missing) == ("forward_only", None, None, [])
    assert 0.05 < found.dead_band_forward < 0.2 and found.drag_deceleration_mps2 > 2
    assert "m/s² in neutral: the ESC has a drag brake" in found.seen["esc/drag_deceleration"]
    assert 0.3 < fitted(virtual_escs.race, drag_brake=0.0).drag_deceleration_mps2 < 0.6


def driven(*actions):
    person = Person(virtual_escs.xl5(dwell_s=0.25), seed=5)
    person.center(2.0)
    for name, times, *arguments in actions:
        for _ in range(times):
            getattr(person, name)(*arguments)
            person.center()
    return fit(person.recorded())


@pytest.mark.parametrize("actions, hints", [
    ([("forward", 3)], ["the profile: full stick for a good second, pull back all the way, and hold until the car"]),
    ([("brake", 1), ("reverse", 1, 0.7)], ["the profile: after a brake, center the stick for a second and pull back"]),
    ([("reverse", 3, 0.8)], [
        "esc/dwell: after a brake, center the stick for less than 0.5 s and pull back for a second; several times",
        "esc/reverse_after_neutral: full stick for a good second, center it, and after 8 s pull back all the way",
        "esc/dead_band_forward: from standstill, push the stick so slowly that the car just sets off; three times"]),
    ([("set_off", 3, 1), ("reverse", 3, 0.8)], ["esc/dead_band_reverse: from standstill, pull the stick so slowly"]),
    ([("brake", 4)], ["the profile: after a brake, center the stick for a second and pull back",
                      "esc/drag_deceleration: full stick for a good second, then center it until the car stands"]),
], ids=["no_brake", "one_of_each", "no_quick_one", "no_creeping_backward", "brakes_alone"])
def test_what_the_drive_does_not_show_is_refused_with_what_to_drive(actions, hints):
    missing = driven(*actions).missing
    assert [hint for hint in hints if not any(text.startswith(hint) for text in missing)] == []


def test_brakes_that_contradict_each_other_name_no_profile():
    holds, turns = Person(virtual_escs.xl5(), seed=1), Person(virtual_escs.crawler(), seed=1)
    for person in (holds, turns):
        person.center(2.0)
        for _ in range(3):
            person.brake()
            person.center()
    found = fit(holds.recorded(), turns.recorded())
    assert found.profile is None
    assert "of 6 brakes after driving forward, 3 held the car and 3 drove it backward" in found.missing[0]


def driven_backward_by(times, make, with_pulses=True, **car):
    """The fit of some brakes that are held until the car rolls backward."""
    person = Person(make(), EscCarConfig(**car), seed=5)
    person.center(2.0)
    for _ in range(times):
        person.brake()
        person.center()
    drive = person.recorded()
    return fit(drive if with_pulses else drive._replace(wheels=()))


def test_pause_by_the_wheels_pulses_tells_a_crawler_unless_it_turns_at_once_from_a_direct_esc():
    alike = {"brake_mps2": 4.0, "reverse_mps2": 4.0}
    assert driven_backward_by(3, lambda: virtual_escs.crawler(turn_s=0.12), **alike).profile == "brake_becomes_reverse"
    assert driven_backward_by(3, virtual_escs.direct, **alike).profile == "direct_reverse"
    found = driven_backward_by(4, lambda: virtual_escs.crawler(turn_s=0.0), brake_mps2=8.0, reverse_mps2=2.5)
    assert found.profile is None and "it is not clear whether it brakes first" in found.missing[0]


def test_without_pulses_only_a_long_pause_names_a_profile():
    def profile(make):
        return driven_backward_by(3, make, with_pulses=False).profile
    assert profile(lambda: virtual_escs.crawler(turn_s=0.4)) == "brake_becomes_reverse"
    assert profile(lambda: virtual_escs.crawler(turn_s=0.05)) is profile(virtual_escs.direct) is None
    found = driven_backward_by(3, virtual_escs.direct, with_pulses=False)
    assert found.missing[0].endswith("and record the wheels' pulses, too (rosbag record -a)")


def second_pulls(esc, *neutrals_s):
    person = Person(esc, seed=5)
    person.center(2.0)
    for neutral_s in neutrals_s:
        person.reverse(neutral_s)
    return person


def test_second_pulls_that_contradict_each_other_name_no_profile():
    esc = virtual_escs.xl5(dwell_s=0.8)
    assert fit(second_pulls(esc, 1.0, 1.0, 1.0).recorded()).profile == "brake_then_reverse"
    assert fit(second_pulls(esc, 1.0, 1.0, 0.6, 1.0).recorded()).profile is None


def test_esc_that_was_once_seen_to_reverse_is_not_forward_only():
    esc = virtual_escs.xl5(dwell_s=2.0, forget_s=3.0)
    person = second_pulls(esc, 0.6, 0.7, 0.8, 0.6)
    assert fit(person.recorded()).profile == "forward_only"  # so it looks as yet
    person.wait_and_pull(4.0)
    assert fit(person.recorded()).profile is None


def test_brake_of_a_car_that_still_rolls_does_not_show_that_the_esc_remembers():
    person = second_pulls(virtual_escs.vxl(forget_s=1.5, dwell_s=0.2), 0.8, 0.7, 0.9)
    person.hold(1.0, 10, lambda speed: speed > 3.5)
    person.hold(0, 2.0)
    assert person.car.speed_mps > 1.0
    person.hold(-0.5, 3.0, lambda speed: speed < -0.6)
    person.center()
    person.wait_and_pull(4.0)
    found = fit(person.recorded())
    assert found.reverse_after_neutral_s == 0.5
    assert found.seen["esc/reverse_after_neutral"].endswith("pull was reverse, and none from standstill was a brake")


def test_only_a_long_wait_shows_that_an_esc_never_forgets_and_waits_that_contradict_each_other_show_nothing():
    person = second_pulls(virtual_escs.xl5(), 0.8, 0.7, 0.9)
    forgets = virtual.VirtualEsc(virtual_escs.xl5(forget_s=3.0))
    found = []
    for wait_s in (1.0, 6.5, 4.0):
        person.wait_and_pull(wait_s)
        found.append(fit(person.recorded()))
        if wait_s == 6.5:
            person.replace_esc(forgets)
            person.center(1.0)
    assert [one.reverse_after_neutral_s for one in found] == [None, 0.0, None]
    assert any(text.endswith("twice (they contradict each other)") for text in found[-1].missing)
