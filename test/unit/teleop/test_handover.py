"""Whose requests count: the gamepad's or the phone's. Each change from one to the other passes through a stop."""
import itertools
import math
from dataclasses import replace

import pytest

from car_interface.teleop.gamepad import Gamepad, GamepadConfig
from car_interface.teleop.handover import Handover

MS = 1_000_000
NOW = 1_000_000_000_000
CONFIG = GamepadConfig(steer_axis=0, throttle_axis=1, manual_button=0, autonomous_button=1)
LET_GO, HELD, WATCHED = (0, 0), (1, 0), (0, 1)
PAD, PHONE = 0.25, 0.75  # the throttle of each
STOPPED = (False, 0.0)


class Bench:
    """Both repeat what they send each 50 ms; ``None`` = silent."""

    def __init__(self, pad=LET_GO, phone=LET_GO):
        self.handover = Handover(CONFIG)
        self.now_ns = NOW
        self.pad, self.phone = pad, phone
        self.run()

    def run(self, times=6):
        for _ in range(times):
            self.now_ns += 50 * MS
            self.handover.requests(self.now_ns)
            if self.pad is not None:
                self.handover.gamepad.update((0.0, PAD if any(self.pad) else 0.0), self.pad, self.now_ns)
            self.handover.requests(self.now_ns)
            if self.phone is not None:
                self.handover.phone.update((0.0, PHONE if any(self.phone) else 0.0), (*self.phone, 0, 0), self.now_ns)
            self.handover.requests(self.now_ns)
        return self

    def then(self, **what):
        for name, value in what.items():
            setattr(self, name, value)
        self.run(1)
        at_once = self.granted
        self.run()
        assert self.granted == at_once
        return at_once

    @property
    def requests(self):
        return self.handover.requests(self.now_ns)

    @property
    def granted(self):
        return self.requests.human_in_loop, self.requests.throttle


def test_either_drives_alone_also_where_the_other_was_never_heard():
    for phone in (None, LET_GO):
        assert Bench(phone=phone).then(pad=HELD) == (True, PAD)
    for pad in (None, LET_GO):
        assert Bench(pad=pad).then(phone=HELD) == (True, PHONE)


@pytest.mark.parametrize("steps", [
    # What happens, and what is granted then.
    [({"pad": HELD}, (True, PAD)), ({"phone": HELD}, (True, PAD)), ({"pad": LET_GO}, STOPPED),
     ({"phone": LET_GO}, STOPPED), ({"phone": HELD}, (True, PHONE))],
    [({"pad": HELD}, (True, PAD)), ({"phone": HELD}, (True, PAD)), ({"phone": LET_GO}, (True, PAD)),
     ({"pad": LET_GO}, STOPPED), ({"phone": HELD}, (True, PHONE))],
    [({"phone": HELD}, (True, PHONE)), ({"pad": HELD}, STOPPED), ({"phone": LET_GO}, STOPPED),
     ({"pad": LET_GO}, STOPPED), ({"pad": HELD}, (True, PAD))],
    [({"phone": HELD}, (True, PHONE)), ({"pad": HELD}, STOPPED), ({"pad": LET_GO}, STOPPED),
     ({"pad": HELD}, (True, PAD))],  # the gamepad goes first, whatever the phone holds
    [({"phone": HELD}, (True, PHONE)), ({"pad": WATCHED}, STOPPED), ({"pad": LET_GO}, STOPPED),
     ({"phone": LET_GO}, STOPPED), ({"phone": HELD}, (True, PHONE))],
    [({"pad": HELD}, (True, PAD)), ({"phone": HELD}, (True, PAD)), ({"pad": None}, STOPPED),
     ({"phone": LET_GO}, STOPPED), ({"phone": HELD}, (True, PHONE))],
    [({"phone": HELD}, (True, PHONE)), ({"pad": None}, (True, PHONE)), ({"pad": HELD}, STOPPED),
     ({"pad": LET_GO}, STOPPED), ({"pad": HELD}, (True, PAD))],
    [({"phone": HELD}, (True, PHONE)), ({"phone": None}, STOPPED), ({"phone": HELD}, STOPPED),
     ({"pad": HELD}, (True, PAD))],
], ids=lambda steps: " ".join(f"{name}:{value}" for what, _ in steps for name, value in what.items()))
def test_change_of_the_driver_passes_through_a_stop_and_the_gamepad_goes_first(steps):
    bench = Bench()
    for what, granted in steps:
        if what.get("pad", 0) is None or what.get("phone", 0) is None:
            for name, value in what.items():
                setattr(bench, name, value)
            bench.run(10)  # it is silent after 0.25 s
            assert bench.granted == granted
        else:
            assert bench.then(**what) == granted


def test_no_row_of_touches_has_a_source_drive_on_from_the_other_without_a_stop():
    for row in itertools.product(("pad", "phone"), repeat=6):
        bench, before = Bench(), STOPPED
        for name in row:
            setattr(bench, name, LET_GO if any(getattr(bench, name)) else HELD)
            bench.run(1)
            assert not (before[0] and bench.granted[0] and before != bench.granted), row
            assert not (bench.granted == (True, PHONE) and any(bench.pad)), row
            before = bench.granted


def test_reasons_name_the_one_they_are_about():
    bench = Bench(pad=None)
    assert bench.requests.reason == "phone: no deadman is held"
    bench.then(phone=HELD)
    assert bench.requests.reason == "phone: manual deadman held"
    bench.phone = None
    bench.run(10)
    assert bench.requests[3:5] == ("joy silent", "phone: phone/joy silent for 0.50 s")
    bench.phone = HELD
    bench.run()
    assert bench.requests.reason.startswith("phone: the phone was silent; let go of the deadman, then hold it again")
    bench.then(pad=LET_GO, phone=LET_GO)
    bench.then(pad=HELD)
    assert bench.requests.reason == "manual deadman held"


@pytest.mark.parametrize("source", ["pad", "phone"])
def test_dropped_messages_release_either_until_it_was_let_go(source):
    bench = Bench()
    bench.then(**{source: HELD})
    bench.handover.mark_stale()
    assert not bench.granted[0]
    bench.run()
    assert bench.requests.cause == "not re-armed"
    bench.then(**{source: LET_GO})
    assert bench.then(**{source: HELD})[0]


def test_without_a_phone_requests_are_the_gamepad_s_own():
    handover, alone = Handover(CONFIG), Gamepad(CONFIG)
    for step in range(200):
        now_ns = NOW + 20 * MS * step
        if step % 60 < 40:
            message = (0.1, 0.4 * (step % 7 == 0)), (step % 40 > 10, 0)
            handover.gamepad.update(*message, now_ns)
            alone.update(*message, now_ns)
        assert handover.requests(now_ns) == alone.requests(now_ns)
        assert handover.scale_button(now_ns) == alone.scale_button(now_ns)


def test_scale_s_button_of_either_counts_whoever_drives_and_the_gamepad_goes_first():
    handover = Handover(replace(CONFIG, faster_button=2, slower_button=3))

    def scale(pad, phone):
        handover.gamepad.update((0.0, 0.0), (0, 0, *pad), NOW)
        handover.phone.update((0.0, 0.0), (0, 0, *phone), NOW)
        handover.requests(NOW)
        return handover.scale_button(NOW)
    assert [scale((0, 0), phone) for phone in ((0, 0), (1, 0), (0, 1), (1, 1))] == [0, 1, -1, 0]
    assert [scale((1, 0), phone) for phone in ((0, 0), (0, 1))] == [1, 1]
    assert scale((0, 0), (0, 1)) == -1 and handover.scale_button(NOW + 251 * MS) == 0


def test_pull_by_phone_just_after_one_by_gamepad_begins_with_a_stop_under_a_planner_s_deadman():
    """throttle_arb may still take the phone's pull for the second one under a human's deadman, which is reverse."""
    bench = Bench()
    handover = bench.handover
    bench.then(pad=HELD)
    bench.then(pad=LET_GO)
    bench.now_ns += 50 * MS
    handover.phone.update((0.0, -1.0), (0, 1, 0, 0), bench.now_ns)
    assert math.isnan(bench.requests.throttle)


def test_pull_by_phone_while_nobody_drove_by_gamepad_is_one():
    bench = Bench()
    bench.now_ns += 50 * MS
    bench.handover.phone.update((0.0, -1.0), (0, 1, 0, 0), bench.now_ns)
    assert bench.requests.throttle == -1.0


def test_gamepad_that_drives_goes_on_when_a_phone_is_heard_first_and_its_reasons_are_its_own():
    bench = Bench(phone=None)
    bench.then(pad=HELD)
    assert bench.then(phone=LET_GO) == (True, PAD)
    assert Bench().requests.reason == "no deadman is held"


def test_phone_has_axes_and_scales_of_its_own():
    handover = Handover(replace(CONFIG, steer_axis=3, throttle_axis=4, steer_scale=0.5, throttle_scale=0.5))
    for step, buttons in enumerate(((0, 0, 0, 0), (1, 0, 0, 0), (1, 0, 0, 0))):
        handover.requests(NOW + step * 50 * MS)
        handover.phone.update((0.4, 0.8) if step == 2 else (0.0, 0.0), buttons, NOW + step * 50 * MS)
        requests = handover.requests(NOW + step * 50 * MS)
    assert (requests.steering, requests.throttle) == pytest.approx((0.4, 0.8))
