"""A gamepad's messages as requests. Time is passed in."""
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common import causes
from car_interface.common.errors import ConfigError
from car_interface.teleop.gamepad import Gamepad, GamepadConfig, Requests, is_d_mode_cross, missing_index, remedy

S = 1_000_000_000
NOW = 1000 * S
MANUAL, AUTONOMOUS, BOTH, NONE = [1, 0], [0, 1], [1, 1], [0, 0]

NAN, INF = math.nan, math.inf
SCALE = {"faster_button": 2, "slower_button": 3}
REST, PERIOD = (0.0, 0.0), S // 20  # what a driver repeats at
THROTTLE_THIRD, STEERING_THIRD = ({"third_button": 2, "third_mode": mode} for mode in ("human_throttle",
                                                                                       "human_steering"))
OVERRIDES = "the {} stick overrides the planner by {:.2f}"


def config(**changes):
    settings = {"steer_axis": 0, "throttle_axis": 1, "manual_button": 0, "autonomous_button": 1}
    settings.update(changes)
    return GamepadConfig(**settings)


def gamepad_at_rest(now_ns=NOW, axes=2, buttons=2, **changes):
    """One whose deadmen were seen let go and whose sticks at rest, as they are before anybody drives."""
    gamepad = Gamepad(config(**changes))
    gamepad.update([changes.get("steer_neutral", 0.0)] + [0.0] * (axes - 1) if axes else [], [0] * buttons, now_ns)
    return gamepad


def requests(axes, buttons, age_s=0.1, **changes):
    received_ns = NOW - round(age_s * S)
    gamepad = gamepad_at_rest(received_ns, len(axes), len(buttons), **changes)
    gamepad.update(axes, buttons, received_ns)
    return gamepad.requests(NOW)


@pytest.mark.parametrize("axes, buttons, human, steering, throttle, cause, reason", [
    ([0.5, -0.25], MANUAL, True, 0.5, -0.25, causes.MANUAL, "manual deadman held"),
    ([0.1, -0.1], AUTONOMOUS, True, 0.0, 0.0, causes.AUTONOMOUS, "autonomous deadman held"),
    ([0.5, -0.25], BOTH, True, 0.5, -0.25, causes.MANUAL, "manual deadman held"),
    ([0.5, -0.25], NONE, False, 0.0, 0.0, causes.NO_DEADMAN, "no deadman is held"),
    ([1.5, -7.0], MANUAL, True, 1.0, -1.0, causes.MANUAL, "manual deadman held"),
    ([NAN, 0.0], MANUAL, False, 0.0, 0.0, causes.JOY_NOT_FINITE,
     "the gamepad's steer_axis 0 is nan, no number to act on"),
    ([0.0, INF], AUTONOMOUS, False, 0.0, 0.0, causes.JOY_NOT_FINITE,
     "the gamepad's throttle_axis 1 is inf, no number to act on"),
    ([], MANUAL, False, 0.0, 0.0, causes.JOY_INCOMPLETE, "the gamepad has no axes, but steer_axis is 0"),
    ([0.5], MANUAL, False, 0.0, 0.0, causes.JOY_INCOMPLETE, "the gamepad has 1 axis (0), but throttle_axis is 1"),
    ([0.5, 0.5], [], False, 0.0, 0.0, causes.JOY_INCOMPLETE, "the gamepad has no buttons, but manual_button is 0"),
    ([0.5, 0.5], [1], False, 0.0, 0.0, causes.JOY_INCOMPLETE,
     "the gamepad has 1 button (0), but autonomous_button is 1"),
])
def test_message_is_read_as_requests(axes, buttons, human, steering, throttle, cause, reason):
    assert requests(axes, buttons)[:5] == (human, steering, throttle, cause, reason)


@pytest.mark.parametrize("axes, buttons, changes, steering, throttle", [
    # A neutral request would ask for nothing, and turn_arb would have the planner steer.
    ([-0.001, 0.0], MANUAL, {}, 0.002, 0.0),
    ([-0.002, 0.0], MANUAL, {}, -0.002, 0.0),
    ([0.01, 0.0], MANUAL, {"steer_deadband": 0.05}, 0.1, 0.0),
    ([0.5, 0.0], MANUAL, {"steer_neutral": 0.5}, 0.498, 0.0),
    ([0.8, 0.0], MANUAL, {"steer_neutral": 0.5}, 0.8, 0.0),
    ([1.0, 0.0], MANUAL, {"steer_neutral": 1.0}, 0.998, 0.0),
    ([0.0, 0.0], MANUAL, {"steer_deadband": 0.0}, 0.002, 0.0),
    ([0.9, 0.9], AUTONOMOUS, {"steer_neutral": 0.5}, 0.5, 0.0),
    ([0.9, 0.9], NONE, {"steer_neutral": 0.5}, 0.5, 0.0),
    ([], [], {"steer_neutral": 0.5}, 0.5, 0.0),
    ([0.5, 0.5], MANUAL, {"steer_scale": -1.0, "throttle_scale": 0.2}, -0.5, 0.1),
    ([0.1, 0.2, 0.3, 0.4, 0.5], [0, 0, 1], {"steer_axis": 2, "throttle_axis": 4, "manual_button": 2}, 0.3, 0.5),
])
def test_axes_and_buttons_are_those_of_the_config(axes, buttons, changes, steering, throttle):
    assert requests(axes, buttons, **changes)[1:3] == (pytest.approx(steering), pytest.approx(throttle))


def test_gamepad_that_was_never_received_or_is_stale_holds_no_deadman():
    assert Gamepad(config()).requests(NOW)[:5] == (False, 0.0, 0.0, causes.JOY_NEVER_RECEIVED, "joy was never heard")
    assert requests([0.5, 0.5], MANUAL, age_s=0.25).human_in_loop
    assert requests([0.5, 0.5], MANUAL, age_s=0.26)[:5] == (False, 0.0, 0.0, causes.JOY_STALE, "joy silent for 0.26 s")
    assert requests([0.5, 0.5], MANUAL, age_s=1e6, joy_timeout_s=0.0).human_in_loop
    dropped = gamepad_at_rest()
    dropped.joy.mark_stale()
    assert dropped.requests(NOW)[3:5] == (causes.JOY_STALE, "joy was not heard since messages were dropped")
    assert requests([0.5, 0.5], NONE).mode == requests([0.5, 0.5], AUTONOMOUS, age_s=1.0).mode == "manual"


@pytest.mark.parametrize("third_mode, buttons, steering, throttle, mode", [
    ("human_steering", [0, 0, 1], 0.5, 0.0, "human_steering"),
    ("human_throttle", [0, 0, 1], 0.0, 0.25, "human_throttle"),
    ("human_throttle", [1, 0, 1], 0.5, 0.25, "manual"),
    ("human_throttle", [0, 1, 1], 0.0, 0.25, "human_throttle"),
    ("human_steering", [0, 1, 0], 0.0, 0.0, "autonomous"),
    ("human_steering", [1, 0, 0], 0.5, 0.25, "manual"),
])
def test_third_deadman_shares_the_driving(third_mode, buttons, steering, throttle, mode):
    """The sticks are held before the deadman is pressed, so that they override nothing."""
    read = requests([0.5, 0.25], buttons, third_button=2, third_mode=third_mode)
    assert (read.human_in_loop, read.steering, read.throttle, read.mode) == (True, steering, throttle, mode)
    assert read.reason.startswith(f"{mode} deadman held")


@pytest.mark.parametrize("human, cause, holds", [
    (True, causes.MANUAL, True), (False, causes.NOT_REARMED, True), (False, causes.NO_DEADMAN, False),
    (False, causes.JOY_STALE, False)])
def test_deadman_is_held_also_while_it_has_to_be_released_first(human, cause, holds):
    assert Requests(human, 0.0, 0.0, cause, "").holds_deadman is holds


def test_requests_differ_by_cause_and_sticks_and_by_whether_the_throttle_is_a_stop():
    read = Requests(True, 0.5, NAN, causes.MANUAL, "", causes.OVERRIDE, causes.OFF_CENTER)
    assert read.kind == (causes.MANUAL, causes.OVERRIDE, causes.OFF_CENTER)
    assert read.differs_by == (*read.kind, True)
    assert read._replace(throttle=0.1).differs_by == (*read.kind, False)


def test_gamepad_without_a_throttle_axis_steers_and_its_throttle_is_no_number():
    read = requests([0.5], MANUAL, throttle_axis=-1)
    assert (read.human_in_loop, read.steering) == (True, 0.5)
    assert math.isnan(read.throttle)
    assert read.reason == "manual deadman held, but throttle_axis is -1: this gamepad drives no throttle"
    assert requests([0.5], AUTONOMOUS, throttle_axis=-1).throttle == 0.0


@pytest.mark.parametrize("buttons, age_s, changes, pressed", [
    ([0, 0, 1, 0], 0.1, SCALE, 1), ([0, 0, 0, 1], 0.1, SCALE, -1), ([0, 0, 1, 1], 0.1, SCALE, 0),
    ([0, 0], 0.1, SCALE, 0), ([0, 0, 1], 0.1, SCALE, 1), ([1, 1, 1, 1], 0.1, {}, 0), ([0, 0, 1, 0], 0.3, SCALE, 0)])
def test_buttons_for_the_scale_are_read_while_they_are_fresh_and_a_gamepad_may_lack_them(buttons, age_s, changes,
                                                                                         pressed):
    gamepad = gamepad_at_rest(buttons=len(buttons), **changes)
    gamepad.update([0.0, 0.0], buttons, NOW - round(age_s * S))
    assert gamepad.scale_button(NOW) == pressed
    gamepad.update([NAN, 0.0], buttons, NOW)
    assert gamepad.scale_button(NOW) == 0


@pytest.mark.parametrize("changes, message", [
    ({"autonomous_button": 0}, "autonomous_button is 0; accepted: a button other than manual_button's"),
    ({"third_button": 1}, "third_button is 1; accepted: a button other than autonomous_button's"),
    ({"faster_button": 0}, "faster_button is 0; accepted: a button other than manual_button's"),
    ({"faster_button": 4, "slower_button": 4}, "slower_button is 4; accepted: a button other than faster_button's"),
])
def test_button_that_is_taken_is_refused(changes, message):
    with pytest.raises(ConfigError, match=message):
        config(**changes)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=3),
       st.lists(st.integers(0, 1), max_size=3))
def test_message_of_anything_is_in_range_and_without_a_held_button_nobody_is_there(axes, buttons):
    read = requests(axes, buttons)
    assert -1 <= read.steering <= 1
    assert -1 <= read.throttle <= 1
    assert read.human_in_loop <= any(buttons[:2])
    if not read.human_in_loop:
        assert (read.steering, read.throttle) == (0.0, 0.0)


@pytest.mark.parametrize("lose, gap_s, reason", [
    # The node may be the successor of one that died while the car was driving.
    (lambda gamepad: Gamepad(config()), 0.0, "this node has just started"),
    (lambda gamepad: None, 0.26, "the gamepad was silent"),
    (lambda gamepad: gamepad.joy.mark_stale(), 0.0, "messages were dropped"),  # in which the hand may have let go
    (lambda gamepad: gamepad.update([NAN, 0.0], MANUAL, NOW), 0.0, "the gamepad's steer_axis was nan"),
    (lambda gamepad: gamepad.update([0.0, INF], MANUAL, NOW), 0.0, "the gamepad's throttle_axis was inf"),
    (lambda gamepad: gamepad.update([0.0], MANUAL, NOW), 0.0, "the gamepad had no throttle_axis"),
    (lambda gamepad: gamepad.update([0.0, 0.0], [], NOW), 0.0, "the gamepad had no manual_button"),
])
def test_after_a_loss_nothing_is_held_until_all_deadmen_were_let_go(lose, gap_s, reason):
    gamepad, at_ns = gamepad_at_rest(), NOW + round(gap_s * S)
    gamepad.update([0.0, 0.0], MANUAL, NOW)
    assert gamepad.requests(NOW).human_in_loop
    gamepad = lose(gamepad) or gamepad
    assert not gamepad.requests(at_ns).human_in_loop
    for still_held in (MANUAL, BOTH, AUTONOMOUS):
        gamepad.update([0.0, 0.0], still_held, at_ns)
        read = gamepad.requests(at_ns)
        assert read[:4] == (False, 0.0, 0.0, causes.NOT_REARMED)
        assert read.reason == f"{reason}; let go of the deadman, then hold it again"
    gamepad.update([0.0, 0.0], NONE, at_ns)
    assert gamepad.requests(at_ns).cause != causes.NOT_REARMED
    gamepad.update([0.0, 0.0], MANUAL, at_ns)
    assert gamepad.requests(at_ns).human_in_loop


def test_first_axis_or_button_that_a_gamepad_lacks_is_named_with_what_it_has():
    shipped = config(throttle_axis=4, third_button=10)
    assert missing_index(shipped, 4, 12) == ("throttle_axis", "the gamepad has 4 axes (0 to 3), but throttle_axis is 4")
    assert missing_index(shipped, 5, 10)[0] == "third_button"
    assert missing_index(shipped, 5, 11) is None


@pytest.mark.parametrize("cause, words", [
    (causes.JOY_NEVER_RECEIVED, "whether joy_node runs and finds the gamepad: rostopic info /car1/joy"),
    (causes.JOY_STALE, "whether the gamepad is on, charged and in range"),
    (causes.JOY_INCOMPLETE, "A Logitech F710 or F310 needs its switch at X"),
    (causes.JOY_NOT_FINITE, "See what sends it: rostopic info /car1/joy"),
])
def test_cause_that_letting_go_does_not_cure_has_a_remedy(cause, words):
    assert words in remedy(cause, "/car1/joy")
    assert remedy(causes.NOT_REARMED, "/car1/joy") == ""


def test_age_and_size_of_the_newest_message_are_known():
    gamepad = Gamepad(config())
    assert gamepad.joy.age_s(NOW) == INF and not gamepad.joy.was_received
    assert (gamepad.axes, gamepad.buttons, gamepad.scale_button(NOW)) == (0, 0, 0)
    gamepad.update([0.0] * 8, [0] * 11, NOW)
    assert (gamepad.axes, gamepad.buttons, gamepad.joy.age_s(NOW + S)) == (8, 11, 1.0) and gamepad.joy.was_received


class Person:
    """Two sticks and the buttons of a gamepad whose driver repeats 20 times a second."""

    def __init__(self, axes=REST, buttons=NONE, **changes):
        self.gamepad = Gamepad(config(**changes))
        self.now_ns = NOW
        self.seen = []  # the requests after each message
        self.hold(axes, [0] * len(buttons))

    def hold(self, axes, buttons, seconds=0.05):
        """Hold the sticks and buttons so for a while; the last requests."""
        for _ in range(max(1, round(seconds * 20))):
            self.now_ns += PERIOD
            self.gamepad.update(axes, buttons, self.now_ns)
            self.seen.append(self.gamepad.requests(self.now_ns))
        return self.seen[-1]


@pytest.mark.parametrize("buttons, changes, axes, steering, throttle", [
    (AUTONOMOUS, {}, (0.5, -0.8), 0.5, -0.8),
    (AUTONOMOUS, {}, (0.5, 0.0), 0.5, 0.0),
    (AUTONOMOUS, {}, (0.0, 0.4), 0.0, 0.4),
    ([0, 0, 1], THROTTLE_THIRD, (0.5, 0.0), 0.5, 0.0),
    ([0, 0, 1], STEERING_THIRD, (0.002, 0.4), 0.002, 0.4),
    (AUTONOMOUS, {"override_deadband": 0.45}, (0.5, 0.4), 0.5, 0.0),
    (AUTONOMOUS, {"steer_scale": -1.0, "throttle_scale": -1.0}, (0.5, 0.4), -0.5, -0.4),
])
def test_stick_that_is_moved_under_any_deadman_has_its_actuator_at_once_and_the_reason_says_so(
        buttons, changes, axes, steering, throttle):
    person = Person(buttons=buttons, **changes)
    before = person.hold(REST, buttons)
    assert before[5:] == ("", "") and before.reason == f"{before.mode} deadman held"
    read = person.hold(axes, buttons)
    assert read[:3] == (True, steering, throttle) and read.mode == before.mode
    moved = [(name, value) for name, value in (("steering", steering), ("throttle", throttle)) if abs(value) > 0.1]
    assert read.reason == "; ".join([before.reason, *(OVERRIDES.format(*each) for each in moved)])
    assert [stick == causes.OVERRIDE for stick in read[5:]] == [abs(steering) > 0.1, abs(throttle) > 0.1]


@pytest.mark.parametrize("drift, steering", [(0.0, 0.002), (0.09, 0.09), (-0.09, -0.09)])
def test_stick_that_rests_or_drifts_overrides_nothing_and_half_a_second_later_the_planner_steers(drift, steering):
    person = Person(axes=(drift, drift))
    assert person.hold((drift, drift), AUTONOMOUS, 5.0)[1:3] == (0.0, 0.0)
    assert person.hold((0.5, 0.5), AUTONOMOUS)[1:3] == (0.5, 0.5)
    assert person.hold((drift, drift), AUTONOMOUS, 0.5)[1] == steering  # nearly neutral: the human's still
    assert person.hold((drift, drift), AUTONOMOUS)[1:3] == (0.0, 0.0)


@pytest.mark.parametrize("low, high, seconds", [(0.09, 0.11, 0.05), (0.0, 0.11, 0.3), (0.08, 0.13, 0.4)])
def test_chatter_at_the_edge_does_not_give_the_actuator_back_and_forth(low, high, seconds):
    person = Person()
    person.hold(REST, AUTONOMOUS)
    person.hold((high, high), AUTONOMOUS)
    person.seen.clear()
    for _ in range(30):
        person.hold((low, low), AUTONOMOUS, seconds)
        person.hold((high, high), AUTONOMOUS, seconds)
    assert {(read.steering_stick, read.throttle_stick) for read in person.seen} == {(causes.OVERRIDE, causes.OVERRIDE)}
    assert all(read.steering for read in person.seen)


@pytest.mark.parametrize("between", [BOTH, NONE])
def test_stick_that_was_held_when_the_deadman_was_pressed_overrides_nothing_until_it_was_centered(between):
    person = Person()
    person.hold(REST, AUTONOMOUS)
    person.hold((0.5, 0.5), AUTONOMOUS)
    person.hold((0.5, 0.5), between)
    assert person.hold((0.5, 0.5), AUTONOMOUS)[1:3] == (0.0, 0.0)
    assert person.hold((0.5, 0.5), BOTH)[1:3] == (0.5, 0.5)
    read = person.hold((0.6, 0.7), AUTONOMOUS, 3.0)
    assert read[1:3] == (0.0, 0.0) and read[5:] == (causes.OFF_CENTER, causes.OFF_CENTER)
    assert read.reason == ("autonomous deadman held; the steering stick, at 0.60, was off its center when the deadman "
                           "was pressed: center it once; the throttle stick, at 0.70, was off its center when the "
                           "deadman was pressed: center it once")
    person.hold((0.02, 0.02), AUTONOMOUS)
    assert person.hold((0.5, 0.5), AUTONOMOUS)[1:3] == (0.5, 0.5)


@pytest.mark.parametrize("buttons, changes", [(AUTONOMOUS, {}), ([0, 0, 1], {"third_button": 2})])
def test_pull_brakes_though_it_was_held_when_the_deadman_was_pressed_and_a_push_after_it_does_not_count(buttons,
                                                                                                         changes):
    person = Person(buttons=buttons, **changes)
    person.hold((0.0, -0.9), [0] * len(buttons))
    assert person.hold((0.0, -0.9), buttons).throttle == -0.9
    read = person.hold((0.0, 0.9), buttons)
    assert (read.throttle, read.throttle_stick) == (0.0, causes.OVERRIDE)
    assert person.hold((0.0, 0.9), buttons, 2.0).throttle == 0.0


@pytest.mark.parametrize("rest", [0.07, -0.07, 0.099])
def test_throttle_that_rests_within_its_dead_band_is_sent_as_none_while_the_override_lasts(rest):
    """Beyond throttle_arb's dead band, whose own half second would begin only when this one is over."""
    person = Person()
    person.hold(REST, AUTONOMOUS)
    assert person.hold((0.0, -0.9), AUTONOMOUS).throttle == -0.9
    read = person.hold((0.0, rest), AUTONOMOUS)
    assert (read.throttle, read.throttle_stick) == (0.0, causes.OVERRIDE)


@pytest.mark.parametrize("rest", [1.0, -1.0])
def test_trigger_in_the_place_of_a_stick_never_drives_nor_steers(rest):
    person = Person(axes=(rest, rest))
    read = person.hold((rest, rest), MANUAL, 2.0)
    assert read.human_in_loop and read.steering == 0.002 and math.isnan(read.throttle)
    assert (read.steering_stick, read.throttle_stick) == (causes.NOT_AT_REST, causes.NOT_AT_REST)
    assert read.reason == (f"manual deadman held; the gamepad's steer_axis 0 is {rest:.2f} and was not seen at its "
                           f"rest: it doesn't count; the gamepad's throttle_axis 1 is {rest:.2f} and was not seen at "
                           "its rest: it doesn't count")
    person.hold((rest, rest), NONE)
    read = person.hold((rest, rest), AUTONOMOUS, 2.0)
    assert (read.steering, read.throttle) == (0.0, min(0.0, rest))  # as a brake it counts
    assert read.reason.endswith("it doesn't count" if rest > 0 else "it only brakes")


def test_axis_counts_once_it_stayed_at_its_rest_which_a_trigger_only_passes():
    person = Person(axes=(0.0, 1.0))
    for axis in (1.0, 0.6, 0.2, -0.05, -0.4, -1.0, -0.5, 0.05, 0.6, 1.0):
        person.hold((0.0, axis), MANUAL)
    assert all(math.isnan(read.throttle) for read in person.seen if read.human_in_loop)
    person.hold(REST, NONE, 0.2)
    assert person.hold((0.5, 0.5), MANUAL)[1:3] == (0.5, 0.5)


@pytest.mark.parametrize("lose", [
    lambda person: person.gamepad.update((0.5, 0.5, 0.0), [0, 0, 0], person.now_ns),
    lambda person: setattr(person, "now_ns", person.now_ns + S),
    lambda person: person.gamepad.joy.mark_stale(),
    lambda person: person.hold((NAN, 0.0), NONE),
    lambda person: person.hold((), NONE),
], ids=["another_mode", "silence", "dropped_messages", "no_number", "no_axes"])
def test_what_was_seen_of_an_axis_ends_with_a_loss(lose):
    person = Person()
    person.hold((0.5, 0.5), NONE)
    lose(person)
    person.hold((0.5, 0.5), NONE)
    assert math.isnan(person.hold((0.5, 0.5), MANUAL).throttle)


def test_cross_is_axis_4_and_5_of_6_with_12_buttons():
    assert [axis for axis in range(7) if is_d_mode_cross(axis, 6, 12)] == [4, 5]
    assert not is_d_mode_cross(4, 8, 11)


@pytest.mark.parametrize("stick", [0.011, -0.3, 0.989])
def test_cross_of_a_gamepad_in_d_mode_does_not_count_until_it_gave_what_no_cross_gives(stick):
    """Axis 4 of a Logitech F710 with its switch at D: it rests at 0."""
    def axes(throttle):
        return [0.0] * 4 + [throttle, 0.0]

    def buttons(manual):
        return [0] * 4 + [manual] + [0] * 7
    person = Person(axes(0.0), buttons(0), throttle_axis=4, manual_button=4, autonomous_button=5)
    for cross in (0.0, 1.0, 0.0, -1.0, 0.01, 0.99, 0.0):
        read = person.hold(axes(cross), buttons(1), 0.5)
        assert math.isnan(read.throttle) and read.throttle_stick == causes.NOT_AT_REST
    assert read.reason == ("manual deadman held; the gamepad's throttle_axis 4 is where a gamepad with 6 axes and 12 "
                           "buttons has its cross: it doesn't count")
    assert "needs its switch at X" in remedy(read.stick_cause, "/joy")
    person.hold(axes(stick), buttons(1))
    person.hold(axes(0.0), buttons(1), 0.2)
    assert person.hold(axes(1.0), buttons(1)).throttle == 1.0
    person.now_ns += S  # another gamepad may send since
    person.hold(axes(0.0), buttons(0), 0.2)
    assert math.isnan(person.hold(axes(1.0), buttons(1)).throttle)


def test_pull_just_after_the_manual_deadman_begins_with_a_stop_so_that_it_is_no_second_pull():
    person = Person()
    person.hold((0.0, -1.0), MANUAL, 0.3)
    person.hold(REST, MANUAL, 0.3)
    person.hold(REST, AUTONOMOUS)
    read = person.hold((0.0, -1.0), AUTONOMOUS)
    assert math.isnan(read.throttle)
    assert read.reason == ("autonomous deadman held; a pull just after another deadman begins with a stop; "
                           "the throttle stick overrides the planner by -1.00")
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS, 0.1).throttle)  # longer than a stall of the gamepad's topic
    assert person.hold((0.0, -1.0), AUTONOMOUS).throttle == -1.0


@pytest.mark.parametrize("between", [AUTONOMOUS, NONE])
def test_so_does_one_that_is_held_through_the_change_but_no_later_one(between):
    person = Person()
    person.hold((0.0, -1.0), MANUAL, 0.3)
    person.hold((0.0, -1.0), between)
    person.gamepad.update((0.0, -1.0), AUTONOMOUS, person.now_ns)
    assert math.isnan(person.gamepad.requests(person.now_ns).throttle)
    assert person.hold((0.0, -1.0), AUTONOMOUS, 0.15).throttle == -1.0
    person.hold(REST, AUTONOMOUS, 1.2)
    for _ in range(3):
        assert person.hold((0.0, -1.0), AUTONOMOUS).throttle == -1.0
        person.hold(REST, AUTONOMOUS)


@pytest.mark.parametrize("pull, is_one", [(-0.02, True), (-0.019, False)])
def test_a_pull_is_one_from_the_smallest_dead_band_of_an_esc_on(pull, is_one):
    person = Person()
    person.hold((0.0, pull), MANUAL, 0.3)
    person.hold(REST, MANUAL, 0.3)
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS).throttle) == is_one


@pytest.mark.parametrize("released_s, is_second", [(0.95, True), (1.0, False)])
def test_a_pull_is_forgotten_once_no_deadman_was_held_for_a_second(released_s, is_second):
    person = Person()
    person.hold((0.0, -1.0), MANUAL, 0.3)
    person.hold(REST, MANUAL)
    person.hold(REST, NONE, released_s)
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS).throttle) == is_second


@pytest.mark.parametrize("watched_s, is_second", [(0.9, True), (0.95, False)])
def test_throttle_arb_knows_a_planner_s_deadman_after_a_second(watched_s, is_second):
    person = Person()
    person.hold((0.0, -1.0), MANUAL)
    person.hold(REST, AUTONOMOUS, watched_s)
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS).throttle) == is_second


def test_stop_before_a_pull_ends_with_the_planner_s_deadman():
    person = Person()
    person.hold((0.0, -1.0), MANUAL)
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS).throttle)
    person.hold(REST, MANUAL)
    assert person.hold(REST, AUTONOMOUS).throttle == 0.0


def test_another_source_s_pulls_count_as_its_own():
    person = Person()
    person.hold(REST, MANUAL, 0.3)
    person.gamepad.follow(person.now_ns)
    assert math.isnan(person.hold((0.0, -1.0), AUTONOMOUS).throttle)


def test_gamepad_whose_buttons_nobody_has_explained_drives_nothing_and_says_so():
    gamepad = Gamepad(config(), unmapped="it is an Unknown Pad")
    for buttons in (NONE, MANUAL):
        gamepad.update([0.5, 0.5], buttons, NOW)
        assert gamepad.requests(NOW)[:5] == (False, 0.0, 0.0, causes.JOY_UNMAPPED, "it is an Unknown Pad")
