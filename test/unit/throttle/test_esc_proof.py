"""When an ESC has shown that its brake doesn't become reverse: the whole story, and nothing less."""

from types import SimpleNamespace

import pytest

from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_motion import MeasuredMotion
from car_interface.throttle.esc_proof import TIMES, BrakeProof

MS, S = 1_000_000, 1_000_000_000


class Story:
    """What the ESC gets and what the car does, in steps of 20 ms; the board holds at once what is sent."""

    def __init__(self):
        self.proof = BrakeProof(0.5)
        self._motion = MeasuredMotion(EscConfig())
        self._now_ns, self._pulled_ns, self._speed_mps = S, 0, 0.0

    def then(self, fraction, seconds, speed_mps, is_measured=True):
        """The speed changes evenly to that."""
        steps = round(seconds / 0.02)
        change_mps = (speed_mps - self._speed_mps) / steps
        for _ in range(steps):
            self._now_ns += 20 * MS
            self._speed_mps += change_mps
            self._pulled_ns = self._pulled_ns + 20 * MS if fraction < 0 else 0
            if is_measured:
                self._motion.update(self._speed_mps, self._now_ns)
            else:
                self._motion.mark_stale()
            self.proof.step(fraction, fraction > 0, self._pulled_ns, self._motion, self._now_ns)
        return self

    def once(self, drives=2.0, brakes=(-0.6, 0.5), holds=1.5, pause_s=0.0, again=1.0):
        """Driven, braked, held, and driven again."""
        self.then(0.5, 1.0, drives)
        if pause_s:
            self.then(0.0, pause_s, drives)
        return self.then(*brakes, 0.0).then(-0.6, holds, 0.0).then(0.5, 1.2, again)


def test_it_takes_the_story_to_its_end_twice_and_a_pause_between_push_and_brake_is_a_person_s():
    story = Story().once(pause_s=0.2).then(0.5, 1.0, 2.0).then(-0.6, 0.5, 0.0).then(-0.6, 1.5, 0.0)
    assert not story.proof.is_given
    assert story.then(0.5, 1.2, 1.0).proof.is_given
    assert story.then(0.0, 5.0, 0.0).once(holds=0.5).proof.is_given


@pytest.mark.parametrize("changes", [
    pytest.param({"drives": 0.9, "brakes": (-0.6, 0.25)}, id="it_was_slow"),
    pytest.param({"brakes": (-0.4, 0.5)}, id="a_weak_brake"),
    pytest.param({"brakes": (-0.6, 1.5)}, id="it_coasted_to_a_stop"),
    pytest.param({"brakes": (-0.6, 0.14)}, id="it_hit_something"),
    pytest.param({"holds": 1.0}, id="held_for_less_than_a_second"),
    pytest.param({"again": 0.0}, id="it_did_not_drive_again"),
    pytest.param({"again": -1.0}, id="it_drove_backward_at_a_push"),
    pytest.param({"pause_s": 0.4}, id="it_had_coasted_before"),
])
def test_what_is_no_such_story_proves_nothing_however_often(changes):
    story = Story()
    for _ in range(5):
        story.once(**changes)
    assert not story.proof.is_given


def is_proven(pull_ms=300, pull=-0.5, first_mps=1.0, slowed_ms=300, slow_mps=0.3, lets_go=False, held_ms=1000,
              pulled_ms=1000, pause_ms=0, push_mps=0.0, wait_ms=1000, again_mps=0.3):
    """Whether a story is one that proves it; by default it just does, at each of its limits."""
    proof, now_ns = BrakeProof(0.5), S

    def step(later_ms, fraction, speed_mps, pulled_ms=0):
        nonlocal now_ns
        now_ns += later_ms * MS
        motion = SimpleNamespace(measured_ns=now_ns, speed_mps=lambda _: speed_mps, stands=lambda _: speed_mps < 0.1)
        proof.step(fraction, fraction > 0, pulled_ms * MS, motion, now_ns)

    for _ in range(TIMES):
        step(0, 0.5, 2.0)
        step(pull_ms, 0.0, first_mps)
        step(0, pull, first_mps)
        step(slowed_ms, pull, slow_mps)
        if lets_go:
            step(20, 0.0, slow_mps)
        step(20, pull, 0.0)
        step(held_ms, pull, 0.0, pulled_ms)
        step(pause_ms, 0.0, 0.0)
        step(0, 0.5, push_mps)
        step(wait_ms, 0.5, 0.0)
        step(20, 0.5, again_mps)
    return proof.is_given


@pytest.mark.parametrize("changes, proven", [
    ({}, True), ({"pull_ms": 301}, False), ({"pull": -0.499}, False), ({"first_mps": 0.999}, False),
    ({"slow_mps": 0.301}, False), ({"first_mps": 1.05, "slowed_ms": 500}, True),  # 1.5 m/s²
    ({"first_mps": 1.05, "slowed_ms": 501}, False), ({"first_mps": 1.3, "slowed_ms": 100}, True),  # 10 m/s²
    ({"first_mps": 1.3, "slowed_ms": 99}, False), ({"lets_go": True}, False), ({"held_ms": 999}, False),
    ({"pulled_ms": 999}, False), ({"pause_ms": 60_000}, True), ({"push_mps": 0.3, "again_mps": 0.0}, False),
    ({"wait_ms": 1001}, False), ({"again_mps": 0.299}, False),
], ids=str)
def test_each_limit_of_the_story(changes, proven):
    assert is_proven(**changes) == proven


def test_a_speed_that_was_unknown_in_between_breaks_the_story_and_takes_away_no_proof():
    story = Story()
    for _ in range(3):
        story.then(0.5, 1.0, 2.0).then(-0.6, 0.5, 0.0).then(-0.6, 0.1, 0.0, is_measured=False)
        story.then(-0.6, 1.5, 0.0).then(0.5, 0.5, 1.0)
    assert not story.proof.is_given
    assert story.once().then(0.0, 1.0, 1.0, is_measured=False).once().proof.is_given


def test_what_moves_while_it_is_held_has_to_stand_for_a_second_from_then_on():
    story = Story()
    for _ in range(2):
        story.then(0.5, 1.0, 2.0).then(-0.6, 0.5, 0.0).then(-0.6, 0.5, 0.0).then(-0.6, 0.1, 0.3).then(-0.6, 0.1, 0.0)
        story.then(-0.6, 0.8, 0.0).then(0.5, 0.5, 1.0)
    assert not story.proof.is_given


def test_doubt_takes_it_away():
    story = Story().once().once()
    story.proof.doubt()
    assert not story.once().proof.is_given and story.once().proof.is_given
