"""Keys as steering, throttle and deadmen. Time is passed in."""
import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
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
    KeyboardConfig,
    KeyReader,
    help_text,
)

S = 1_000_000_000
MS = 1_000_000
NOW = 1000 * S
CODE_M, CODE_W, CODE_A, CODE_SHIFT = 50, 17, 30, 42  # linux/input-event-codes.h


@pytest.mark.parametrize("text, keys", [
    ("wasd", [FORWARD, LEFT, BACKWARD, RIGHT]),
    ("WASDMPQ", [FORWARD, LEFT, BACKWARD, RIGHT, MANUAL, AUTONOMOUS, QUIT]),
    ("ec+=-", [SLOWLY_FORWARD, SLOWLY_BACKWARD, MORE, MORE, LESS]),
    ("\x1b[A\x1b[B\x1b[C\x1b[D", [FORWARD, BACKWARD, RIGHT, LEFT]),
    ("\x1bOA\x1bOD", [FORWARD, LEFT]),  # in application mode
    ("\x1b[1;5A", [FORWARD]),  # with Ctrl
    ("\x1b[3~w", [FORWARD]),
    ("\x1bw", [FORWARD]),
    ("m w", [MANUAL, RELEASE, FORWARD]),
    ("xyz1\r\n\t", []),
    ("\x1b[" + "1" * 100, []),
])
def test_characters_are_read_as_keys_whole_and_one_by_one_and_swallow_nothing_that_follows(text, keys):
    reader = KeyReader()
    assert reader.feed(text) == keys
    assert reader.feed("w") == [FORWARD]
    reader = KeyReader()
    assert [key for character in text for key in reader.feed(character)] == keys


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


@pytest.mark.parametrize("delay_ms", [250, 500, 660])  # of a console, of Gnome and of X11
def test_deadman_that_is_held_counts_through_the_delay_of_its_repetition(delay_ms):
    steps = repeated(MANUAL, 0, 3000, delay_ms)
    assert all(typed(*steps, until_ms=until_ms).manual for until_ms in range(0, 3600, 50))
    assert not typed(*steps, until_ms=3000 + 740).manual


@pytest.mark.parametrize("steps, until_ms, controls", [
    (repeated(FORWARD, 0, 2000), 2000, Controls()),
    ([(MANUAL, 0), *repeated(FORWARD, 800, 2000)], 2000, Controls()),
    ([(MANUAL, 0), (FORWARD, 100), (RELEASE, 200)], 200, Controls()),
    ([(MANUAL, 0), (FORWARD, 100), (RELEASE, 200), (FORWARD, 300)], 300, Controls()),
    ([(MANUAL, 0), *repeated(FORWARD, 300, 5000)], 5000, Controls(0.0, 1.0, manual=True)),
    ([(MANUAL, 0), *repeated(FORWARD, 300, 5000)], 5720, Controls()),
    ([(AUTONOMOUS, 0)], 100, Controls(autonomous=True)),
])
def test_key_counts_with_a_deadman_that_lasts_while_others_repeat_and_until_space(steps, until_ms, controls):
    assert typed(*steps, until_ms=until_ms) == controls
    assert typed(*steps, (MANUAL, until_ms + 100), until_ms=until_ms + 100).manual


def test_steering_takes_a_quarter_of_a_second_to_the_end_and_back():
    steps = [(MANUAL, 0), (LEFT, 0)]
    assert typed(*steps, until_ms=100).steering == pytest.approx(0.4, abs=0.05)
    assert typed(*steps, until_ms=300).steering == 1.0
    assert typed(*steps, (MANUAL, 600), until_ms=800).steering == pytest.approx(0.6, abs=0.05)
    assert typed(*steps, (MANUAL, 600), until_ms=1000).steering == 0.0


@pytest.mark.parametrize("keys, steering, throttle", [
    ((LEFT,), 1.0, 0.0), ((LEFT, RIGHT), -1.0, 0.0), ((BACKWARD,), 0.0, -1.0), ((FORWARD, BACKWARD), 0.0, -1.0),
    ((SLOWLY_FORWARD, BACKWARD), 0.0, -1.0), ((RIGHT, FORWARD), -1.0, 1.0)])
def test_without_releases_the_newest_of_opposite_keys_counts(keys, steering, throttle):
    assert typed((MANUAL, 0), *((key, 0) for key in keys), until_ms=500) == Controls(steering, throttle, manual=True)


def test_push_grows_for_half_a_second_and_ends_at_once_and_a_pull_which_brakes_is_whole_at_once():
    steps = [(MANUAL, 0), (FORWARD, 0)]
    assert typed(*steps, until_ms=0).throttle == pytest.approx(0.1)
    assert typed(*steps, until_ms=250).throttle == pytest.approx(0.55, abs=0.05)
    assert typed(*steps, until_ms=600).throttle == 1.0
    assert typed(*steps, (MANUAL, 600), until_ms=720).throttle == 0.0
    assert typed(*steps, (RELEASE, 600), (MANUAL, 620), (BACKWARD, 620), until_ms=640).throttle == -1.0
    assert typed(*steps, (BACKWARD, 600), (RELEASE, 620), (MANUAL, 620), (FORWARD, 640),
                 until_ms=640).throttle == pytest.approx(0.1)


@pytest.mark.parametrize("counts, until_ms", [(False, -1), (True, 700)])
def test_terminal_alone_counts_where_it_may(counts, until_ms):
    """Over ssh it does: this computer's keyboards can be read, but they aren't the one that is typed on."""
    keyboard = Keyboard(counts_without_release=counts)
    assert keyboard.type(MANUAL, NOW) is counts
    for age_ms in (0, 700, 710):
        assert keyboard.controls(NOW + age_ms * MS).manual == (age_ms <= until_ms)


STORIES = {
    "key_counts_until_its_release_without_being_repeated": (False, [
        ("press", CODE_M, 0, False), ("type", MANUAL, 5, True), ("press", CODE_W, 60_000, True),
        ("release", CODE_M, 60_000, False)]),
    "press_counts_by_a_character_that_comes_in_time": (False, [
        ("press", CODE_M, 0, False), ("type", MANUAL, 300, True)]),
    "press_that_is_meant_for_another_window_counts_for_nothing": (False, [
        ("press", CODE_M, 0, False), ("type", MANUAL, 301, False)]),
    "repetition_that_arrives_after_the_release_does_not_count_again": (True, [
        ("press", CODE_M, 0, False), ("type", MANUAL, 5, True), ("release", CODE_M, 1000, False),
        ("type", MANUAL, 1100, False)]),
    "tap_that_ended_before_its_character_came_does_not_count": (True, [
        ("press", CODE_M, 0, False), ("release", CODE_M, 10, False), ("type", MANUAL, 10, False)]),
    "character_that_comes_0_3_s_after_its_release_does_not_count": (True, [
        ("press", CODE_M, 0, False), ("release", CODE_M, 10, False), ("type", MANUAL, 310, False)]),
    "character_that_comes_later_is_that_of_another_keyboard": (True, [
        ("press", CODE_M, 0, False), ("release", CODE_M, 10, False), ("type", MANUAL, 311, True)]),
    "key_that_was_typed_before_its_keyboard_was_read_counts_until_its_release": (True, [
        ("type", MANUAL, 0, True), ("press", CODE_M, 100, True), ("type", MANUAL, 105, True),
        ("release", CODE_M, 200, False)]),
    "key_with_shift_is_the_letter_s": (False, [
        ("press", CODE_SHIFT, 0, False), ("press", CODE_M, 50, False), ("type", MANUAL, 50, True),
        ("release", CODE_SHIFT, 1000, True), ("release", CODE_M, 1000, False)]),
    "held_key_must_be_pressed_again_after_space": (False, [
        ("press", CODE_M, 0, False), ("type", MANUAL, 5, True), ("type", RELEASE, 10, False),
        ("type", MANUAL, 50, False), ("type", MANUAL, 1000, False), ("release", CODE_M, 2000, False),
        ("press", CODE_M, 3000, False), ("type", MANUAL, 3000, True)]),
}


@pytest.mark.parametrize("counts, steps", STORIES.values(), ids=STORIES)
def test_key_of_a_keyboard_that_reports_releases(counts, steps):
    keyboard = Keyboard(counts_without_release=counts)
    for act, value, at_ms, is_held in steps:
        getattr(keyboard, act)(value, NOW + at_ms * MS)
        assert keyboard.controls(NOW + at_ms * MS) == Controls(manual=is_held)


@pytest.mark.parametrize("now_ns", [0, NOW])
def test_character_whose_key_was_released_already_is_obeyed_and_one_without_a_key_is_not(now_ns):
    keyboard = Keyboard(counts_without_release=False)
    assert not keyboard.type(MANUAL, now_ns)
    keyboard.press(CODE_M, now_ns)
    keyboard.release(CODE_M, now_ns)
    assert keyboard.type(MANUAL, now_ns + 300 * MS)


def test_key_is_known_by_its_character_and_each_is_released_by_itself():
    keyboard = Keyboard(counts_without_release=False)
    for code, key in ((CODE_M, MANUAL), (44, FORWARD), (CODE_A, LEFT)):  # 44: what types a w on a French keyboard
        keyboard.press(code, NOW)
        assert keyboard.type(key, NOW) and keyboard.type(key, NOW + MS)  # as it repeats
    assert not keyboard.type(RIGHT, NOW + MS)
    keyboard.controls(NOW)
    assert keyboard.controls(NOW + S) == Controls(1.0, 1.0, manual=True)
    keyboard.release(44, NOW + S)
    assert keyboard.controls(NOW + S) == Controls(1.0, 0.0, manual=True)


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
        assert -1 <= found.steering <= 1 and -1 <= found.throttle <= 1
    for code in (CODE_M, CODE_W, CODE_A):
        keyboard.release(code, now_ns)
    assert keyboard.controls(now_ns + S) == Controls()


def test_help_names_every_key_and_how_to_hold_the_deadman():
    assert all(word in help_text(True) for word in ("M ", "P ", "W A S D", "space", "Q ", "To drive: hold M."))
    assert help_text(False).endswith("To drive: press M, then hold another key: this terminal doesn't say when a key\n"
                                     "is released, so each counts for 0.7 s.")
    assert max(map(len, help_text(False).splitlines())) < 80


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


@pytest.mark.parametrize("keys, throttles", [
    ((SLOWLY_FORWARD,), [0.05, 0.12, 0.19, 0.26]), ((SLOWLY_BACKWARD,), [-0.05, -0.12, -0.19, -0.26]),
    ((SLOWLY_FORWARD, FORWARD), [0.1, 1.0, 1.0, 1.0]), ((SLOWLY_FORWARD, BACKWARD), [-1.0] * 4),
    ((SLOWLY_FORWARD, SLOWLY_BACKWARD), [-0.05, -0.12, -0.19, -0.26])])
def test_slow_key_alone_pushes_ever_farther_from_the_dead_band_on(keys, throttles):
    assert held(*keys, seconds=3) == pytest.approx(throttles)


def test_slow_push_begins_again_after_each_release_and_after_the_deadman():
    keyboard = Keyboard(True)
    for begin_ns, lets_go in ((NOW, False), (NOW + 5 * S, True), (NOW + 6 * S, False)):
        for tick in range(26):
            keyboard.type(MANUAL, begin_ns + tick * 20 * MS)
            keyboard.type(SLOWLY_FORWARD, begin_ns + tick * 20 * MS)
            controls = keyboard.controls(begin_ns + tick * 20 * MS)
        assert controls.throttle == pytest.approx(0.05 + 25 * 0.02 * 0.07)
        if lets_go:
            keyboard.type(RELEASE, begin_ns + 500 * MS)
        assert keyboard.controls(begin_ns + (501 if lets_go else 3000) * MS).throttle == 0.0


def test_keys_for_the_scale_are_buttons_with_a_deadman_only():
    keyboard = Keyboard(True)
    keyboard.type(MORE, NOW)
    assert keyboard.controls(NOW).scale == 0
    keyboard.type(MANUAL, NOW)
    assert keyboard.controls(NOW).scale == 1
    keyboard.type(LESS, NOW)
    assert keyboard.controls(NOW).scale == 0
    assert keyboard.controls(NOW + S).scale == 0


def test_both_deadmen_on_one_button_are_refused():
    with pytest.raises(ConfigError, match=r"autonomous_button.*a button other than manual_button's"):
        KeyboardConfig(manual_button=5, autonomous_button=5)
    assert KeyboardConfig(manual_button=5, autonomous_button=4).manual_button == 5
