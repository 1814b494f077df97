"""Keys as steering, throttle and deadmen. Time is passed in."""
from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.teleop.keyboard import (
    AUTONOMOUS,
    BACKWARD,
    FORWARD,
    LEFT,
    LESS,
    MANUAL,
    MORE,
    QUIT,
    RELEASE,
    RIGHT,
    SLOWLY_BACKWARD,
    SLOWLY_FORWARD,
    Controls,
    Keyboard,
    KeyReader,
    help_text,
)

S = 1_000_000_000
MS = 1_000_000
NOW = 1000 * S
CODE_M, CODE_W, CODE_A, CODE_SHIFT = 50, 17, 30, 42  # linux/input-event-codes.h

# --- what a terminal sends ---


@pytest.mark.parametrize("text, keys", [
    pytest.param("wasd", [FORWARD, LEFT, BACKWARD, RIGHT], id="letters"),
    pytest.param("WASDMPQ", [FORWARD, LEFT, BACKWARD, RIGHT, MANUAL, AUTONOMOUS, QUIT], id="with_caps_lock"),
    pytest.param("ec+=-", [SLOWLY_FORWARD, SLOWLY_BACKWARD, MORE, MORE, LESS], id="slow_keys_and_the_scale"),
    pytest.param("\x1b[A\x1b[B\x1b[C\x1b[D", [FORWARD, BACKWARD, RIGHT, LEFT], id="arrows"),
    pytest.param("\x1bOA\x1bOD", [FORWARD, LEFT], id="arrows_in_application_mode"),
    pytest.param("\x1b[1;5A", [FORWARD], id="arrow_with_ctrl"),
    pytest.param("\x1b[3~w", [FORWARD], id="delete_means_nothing"),
    pytest.param("\x1bw", [FORWARD], id="escape_or_alt_before_a_key"),
    pytest.param("m w", [MANUAL, RELEASE, FORWARD], id="space"),
    pytest.param("xyz1\r\n\t", [], id="keys_that_mean_nothing"),
])
def test_characters_are_read_as_keys_whole_and_one_by_one(text, keys):
    assert KeyReader().feed(text) == keys
    reader = KeyReader()
    assert [key for character in text for key in reader.feed(character)] == keys


def test_escape_sequence_without_an_end_does_not_swallow_what_follows():
    reader = KeyReader()
    assert reader.feed("\x1b[" + "1" * 100) == []
    assert reader.feed("w") == [FORWARD]


@given(st.text(max_size=40))
def test_any_text_is_read_without_an_error_and_later_keys_count(text):
    reader = KeyReader()
    reader.feed(text)
    reader.feed("xx")
    assert reader.feed("w") == [FORWARD]


# --- a terminal alone ---


def typed(*steps, until_ms, counts=True):
    """The controls after (key, time in ms), at a time, asked for every 20 ms as the node does."""
    keyboard, waiting, found = Keyboard(counts), list(steps), Controls()
    for time_ms in range(0, until_ms + 1, 10):
        while waiting and waiting[0][1] <= time_ms:
            keyboard.type(waiting.pop(0)[0], NOW + time_ms * MS)
        found = keyboard.controls(NOW + time_ms * MS)
    return found


def repeated(key, from_ms, to_ms, delay_ms=500):
    """A key that is held from a time to another: it repeats after a delay, 30 times a second."""
    return [(key, from_ms), *((key, time_ms) for time_ms in range(from_ms + delay_ms, to_ms, 33))]


@pytest.mark.parametrize("delay_ms", [250, 500, 660], ids=["console", "gnome", "x11"])
def test_deadman_that_is_held_counts_through_the_delay_of_its_repetition(delay_ms):
    steps = repeated(MANUAL, 0, 3000, delay_ms)
    assert all(typed(*steps, until_ms=until_ms).manual for until_ms in range(0, 3600, 50))
    assert not typed(*steps, until_ms=3000 + 740).manual


@pytest.mark.parametrize("age_ms, counts", [(700, True), (710, False)])
def test_key_of_a_terminal_counts_for_0_7_s(age_ms, counts):
    assert typed((MANUAL, 0), until_ms=age_ms).manual is counts


def test_deadman_counts_while_another_key_repeats_in_its_place():
    steps = [(MANUAL, 0), *repeated(FORWARD, 300, 5000)]
    assert typed(*steps, until_ms=5000) == Controls(0.0, 1.0, manual=True)
    assert typed(*steps, until_ms=5720) == Controls()


def test_key_without_a_deadman_asks_for_nothing_and_arms_none():
    assert typed(*repeated(FORWARD, 0, 3000), until_ms=2000) == Controls()
    assert typed((MANUAL, 0), *repeated(FORWARD, 800, 3000), until_ms=2000) == Controls()


def test_space_lets_go_of_everything_until_it_is_pressed_anew():
    steps = [(MANUAL, 0), (FORWARD, 100), (RELEASE, 200)]
    assert typed(*steps, until_ms=200) == Controls()
    assert typed(*steps, (FORWARD, 300), until_ms=300) == Controls()
    assert typed(*steps, (MANUAL, 300), until_ms=300) == Controls(manual=True)


def test_steering_takes_a_quarter_of_a_second_to_the_end_and_back():
    steps = [(MANUAL, 0), (LEFT, 0)]
    assert typed(*steps, until_ms=100).steering == pytest.approx(0.4, abs=0.05)
    assert typed(*steps, until_ms=300).steering == 1.0
    assert typed(*steps, (MANUAL, 600), until_ms=800).steering == pytest.approx(0.6, abs=0.05)
    assert typed(*steps, (MANUAL, 600), until_ms=1000).steering == 0.0


@pytest.mark.parametrize("keys, steering, throttle", [
    ((LEFT,), 1.0, 0.0), ((RIGHT,), -1.0, 0.0), ((LEFT, RIGHT), 0.0, 0.0),
    ((FORWARD,), 0.0, 1.0), ((BACKWARD,), 0.0, -1.0), ((FORWARD, BACKWARD), 0.0, 0.0), ((RIGHT, FORWARD), -1.0, 1.0),
])
def test_held_keys_add_up(keys, steering, throttle):
    assert typed((MANUAL, 0), *((key, 0) for key in keys), until_ms=500) == Controls(steering, throttle, manual=True)


def test_planner_s_deadman_is_its_own():
    assert typed((AUTONOMOUS, 0), until_ms=100) == Controls(autonomous=True)


def test_terminal_alone_counts_for_nothing_where_it_must_not():
    keyboard = Keyboard(counts_without_release=False)
    assert keyboard.type(MANUAL, NOW) is False
    assert keyboard.controls(NOW) == Controls()


# --- with a keyboard that reports presses and releases ---


def with_events(counts=False):
    """A keyboard on which M is held, and was typed."""
    keyboard = Keyboard(counts)
    keyboard.press(CODE_M, NOW)
    assert keyboard.type(MANUAL, NOW + 5 * MS)
    return keyboard


def test_key_counts_until_its_release_without_being_repeated():
    keyboard = with_events()
    assert keyboard.controls(NOW + 60 * S) == Controls(manual=True)
    keyboard.release(CODE_M, NOW + 60 * S)
    assert keyboard.controls(NOW + 60 * S) == Controls()


def test_press_that_is_meant_for_another_window_counts_for_nothing():
    keyboard = Keyboard(counts_without_release=False)
    keyboard.press(CODE_M, NOW)
    assert keyboard.controls(NOW) == Controls()
    assert keyboard.type(MANUAL, NOW + 301 * MS) is False


def test_key_is_told_by_its_character_whatever_the_layout():
    keyboard = with_events()
    keyboard.press(44, NOW)  # what types a w on a French keyboard
    keyboard.type(FORWARD, NOW)
    assert keyboard.controls(NOW).throttle == 1.0
    keyboard.release(44, NOW)
    assert keyboard.controls(NOW).throttle == 0.0


def test_two_keys_are_released_each_by_itself():
    keyboard = with_events()
    for code, key in ((CODE_W, FORWARD), (CODE_A, LEFT)):
        keyboard.press(code, NOW + S)
        keyboard.type(key, NOW + S)
    keyboard.controls(NOW + S)
    assert keyboard.controls(NOW + 2 * S) == Controls(1.0, 1.0, manual=True)
    keyboard.release(CODE_W, NOW + 2 * S)
    assert keyboard.controls(NOW + 2 * S) == Controls(1.0, 0.0, manual=True)


def test_repetition_that_arrives_after_the_release_does_not_count_again():
    """Over a slow connection, of a terminal that counts by itself otherwise."""
    keyboard = with_events(counts=True)
    keyboard.release(CODE_M, NOW + S)
    keyboard.type(MANUAL, NOW + S + 100 * MS)
    assert keyboard.controls(NOW + S + 100 * MS) == Controls()


def test_tap_that_ended_before_its_character_came_does_not_count():
    keyboard = Keyboard(counts_without_release=True)
    keyboard.press(CODE_M, NOW)
    keyboard.release(CODE_M, NOW + 10 * MS)
    keyboard.type(MANUAL, NOW + 10 * MS)
    assert keyboard.controls(NOW + 10 * MS) == Controls()


def test_key_with_shift_is_the_letter_s():
    keyboard = Keyboard(counts_without_release=False)
    keyboard.press(CODE_SHIFT, NOW)
    keyboard.press(CODE_M, NOW + 50 * MS)
    keyboard.type(MANUAL, NOW + 50 * MS)
    keyboard.release(CODE_SHIFT, NOW + S)
    assert keyboard.controls(NOW + S).manual
    keyboard.release(CODE_M, NOW + S)
    assert not keyboard.controls(NOW + S).manual


def test_after_letting_go_of_everything_a_held_key_must_be_pressed_anew():
    keyboard = with_events()
    keyboard.release_all()
    assert keyboard.type(MANUAL, NOW + 50 * MS) is False  # as it repeats on
    assert keyboard.controls(NOW + 50 * MS) == Controls()
    assert keyboard.type(MANUAL, NOW + S) is False
    keyboard.release(CODE_M, NOW + 2 * S)
    keyboard.press(CODE_M, NOW + 3 * S)
    keyboard.type(MANUAL, NOW + 3 * S)
    assert keyboard.controls(NOW + 3 * S).manual


def test_other_computer_s_keyboard_counts_as_a_terminal_alone_where_it_may():
    """Over ssh: this computer's keyboards can be read, but they aren't the one that is typed on."""
    keyboard = Keyboard(counts_without_release=True)
    keyboard.type(MANUAL, NOW)
    assert keyboard.controls(NOW + 700 * MS).manual
    assert not keyboard.controls(NOW + 710 * MS).manual


STEPS = st.lists(st.one_of(
    st.tuples(st.just("press"), st.sampled_from([CODE_M, CODE_W, CODE_A])),
    st.tuples(st.just("release"), st.sampled_from([CODE_M, CODE_W, CODE_A])),
    st.tuples(st.just("type"), st.sampled_from([MANUAL, FORWARD, LEFT, RELEASE])),
    st.tuples(st.just("wait"), st.integers(0, 1000))), max_size=30)


@given(STEPS, st.booleans())
def test_once_all_keys_were_released_for_a_second_nothing_is_held(steps, counts):
    keyboard, now_ns = Keyboard(counts), NOW
    for kind, value in steps:
        now_ns += value * MS if kind == "wait" else MS
        if kind == "type":
            keyboard.type(value, now_ns)
        elif kind != "wait":
            (keyboard.press if kind == "press" else keyboard.release)(value, now_ns)
        found = keyboard.controls(now_ns)
        assert -1 <= found.steering <= 1 and found.throttle in (-1.0, 0.0, 1.0)
    for code in (CODE_M, CODE_W, CODE_A):
        keyboard.release(code, now_ns)
    assert keyboard.controls(now_ns + S) == Controls()


def test_help_names_every_key_and_how_to_hold_the_deadman():
    assert all(word in help_text(True) for word in ("M ", "P ", "W A S D", "space", "Q ", "To drive: hold M."))
    assert help_text(False).endswith("To drive: press M, then hold another key: this terminal doesn't say when a key\n"
                                     "is released, so each counts for 0.7 s.")
    assert max(map(len, help_text(False).splitlines())) < 80


# --- slow pushes and the scale ---


def held(*keys, seconds):
    """The throttle each second of holding keys beside the deadman."""
    keyboard, found = Keyboard(True), []
    for tick in range(round(seconds * 50) + 1):
        now_ns = NOW + tick * 20 * MS
        if tick % 10 == 0:
            for key in (MANUAL, *keys):
                keyboard.type(key, now_ns)
        controls = keyboard.controls(now_ns)
        if tick % 50 == 0:
            found.append(controls.throttle)
    return found


@pytest.mark.parametrize("key, way", [(SLOWLY_FORWARD, 1), (SLOWLY_BACKWARD, -1)])
def test_slow_key_pushes_ever_farther_from_the_dead_band_on(key, way):
    assert held(key, seconds=3) == pytest.approx([way * 0.05, way * 0.12, way * 0.19, way * 0.26])


def test_slow_push_beside_a_whole_one_or_its_opposite_is_none():
    assert held(SLOWLY_FORWARD, FORWARD, seconds=1) == [1.0, 1.0]
    assert held(SLOWLY_FORWARD, BACKWARD, seconds=1) == [-1.0, -1.0]
    assert held(SLOWLY_FORWARD, SLOWLY_BACKWARD, seconds=1) == [0.0, 0.0]


def test_slow_push_begins_anew_after_each_release():
    keyboard = Keyboard(True)
    for begin_ns in (NOW, NOW + 5 * S):
        for tick in range(26):
            keyboard.type(MANUAL, begin_ns + tick * 20 * MS)
            keyboard.type(SLOWLY_FORWARD, begin_ns + tick * 20 * MS)
            controls = keyboard.controls(begin_ns + tick * 20 * MS)
        assert controls.throttle == pytest.approx(0.05 + 25 * 0.02 * 0.07)
        assert keyboard.controls(begin_ns + 3 * S).throttle == 0.0


def test_keys_for_the_scale_are_buttons_with_a_deadman_only():
    keyboard = Keyboard(True)
    keyboard.type(MORE, NOW)
    assert keyboard.controls(NOW).scale == 0
    keyboard.type(MANUAL, NOW)
    assert keyboard.controls(NOW).scale == 1
    keyboard.type(LESS, NOW)
    assert keyboard.controls(NOW).scale == 0
    assert keyboard.controls(NOW + S).scale == 0
