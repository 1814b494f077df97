"""A person's hands at random: gamepad, arbiter, the ESC's rules, a virtual ESC and its car, with late and lost modes.

What holds: under a deadman that gives the throttle to the planner no pull drives the car backward, however often it is
pulled, whatever was done before under another deadman, and though stick, deadman and mode each arrive up to 0.45 s
late, or the mode no more; and a pull of a car that its planner drives backward never makes it faster. With the right
profile or none, and with known speed or without.

With the mode later than throttle_arb's mode_timeout, as by a connection that is that slow all the time, it can't hold;
nor, with a mode that is late or lost, with calibration_drive, which has the first pull by hand drive backward.
"""

import collections
import os
import random

import pytest
import virtual_escs
from esc_car import EscCar
from many_drives import MS, THROTTLE, S, count_duty

from car_interface.common.causes import HUMAN_DRIVES
from car_interface.common.sources import TELEOP
from car_interface.sim import drive_train as virtual
from car_interface.teleop.gamepad import Gamepad, GamepadConfig
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import UNVERIFIED, EscConfig

DRIVERS = (virtual_escs.xl5, virtual_escs.vxl, virtual_escs.crawler, virtual_escs.direct, virtual_escs.race)
TICK_NS = 10 * MS
DRIVES = 3000 if os.environ.get("CAR_INTERFACE_ALL") else 25
PROMPT_MS, THROTTLE_MS, LATE_MS = 2, 20, 450  # a message takes less
# From the last moment of another deadman to the last pulse that it may still have asked for, without the stick's delay:
# the timer, the way to the chip, and a PWM period.
GRACE_NS = 80 * MS
MANUAL, AUTONOMOUS, THIRD = range(3)
NOBODY, BY_HAND, BY_PLANNER = (), (MANUAL,), (AUTONOMOUS,)


class Topic:
    """Messages in order, each late by itself."""

    def __init__(self, rng, max_ms, deliver):
        self._rng, self._max_ms, self._deliver = rng, max_ms, deliver
        self._messages = collections.deque()  # (when it arrives, message)
        self.is_cut = False

    def send(self, message, now_ns):
        if not self.is_cut:
            earliest_ns = self._messages[-1][0] if self._messages else 0
            self._messages.append((max(earliest_ns, now_ns + self._rng.randrange(1, self._max_ms) * MS), message))

    def tick(self, now_ns):
        while self._messages and self._messages[0][0] <= now_ns:
            self._deliver(self._messages.popleft()[1], now_ns)


class Chip:
    """The servo board's output for the ESC, and what it reports of it."""

    def __init__(self, rng, esc, report):
        self._esc = esc
        self.neutral = self.duty = self._newest = count_duty(esc.neutral_duty)
        self._commands, self._reports = Topic(rng, 10, self._obey), Topic(rng, 60, report)
        self._command_ns = self._published_ns = 0
        self._published = None

    def command(self, fraction, now_ns):
        duty = self._esc.neutral_duty + abs(fraction) * self._full(fraction > 0)
        self._commands.send(count_duty(duty), now_ns)

    def _obey(self, duty, now_ns):
        self._newest, self._command_ns = duty, now_ns

    def _fraction(self, duty):
        forward = duty > self._esc.neutral_duty
        return (duty - self._esc.neutral_duty) / self._full(forward) * (1 if forward else -1)

    def _full(self, forward):
        esc = self._esc
        return (esc.full_forward_duty if forward else esc.full_reverse_duty) - esc.neutral_duty

    def tick(self, now_ns):
        self._commands.tick(now_ns)
        self.duty = self.neutral if now_ns - self._command_ns > 250 * MS else self._newest
        if self.duty != self._published or now_ns - self._published_ns >= 1000 * MS:
            self._published, self._published_ns = self.duty, now_ns
            self._reports.send(self._fraction(self.duty), now_ns)
        self._reports.tick(now_ns)


class Drive:
    """One car, its nodes and a person."""

    def __init__(self, seed):
        self.rng = rng = random.Random(seed)
        esc = DRIVERS[seed % 5](
            dwell_s=rng.uniform(0.1, 0.4), turn_s=rng.uniform(0.0, 0.3), drag_brake=rng.choice((0.0, 0.05, 0.3)),
            second_pull=rng.choice((virtual.REVERSES, virtual.BRAKES, virtual.BRAKES_AND_TURNS)),
            starts_ready=rng.random() < 0.3)
        self.virtual = virtual.VirtualEsc(esc, rng.randrange(20) * MS)
        self.car = EscCar()
        profile = UNVERIFIED if rng.random() < 0.3 else esc.kind
        calibrates = profile == UNVERIFIED and rng.random() < 0.3
        self.control = ThrottleControl(
            THROTTLE, ThrottleArbiterConfig(),
            EscConfig(profile=profile, profile_measured=profile != UNVERIFIED and rng.random() < 0.5,
                      calibration_drive=calibrates))
        self.chip = Chip(rng, esc, self.control._esc.update_held)
        arbiter = self.control.arbiter
        self.gamepad = Gamepad(GamepadConfig(0, 1, MANUAL, AUTONOMOUS, third_button=THIRD))
        throttle_ms = PROMPT_MS if calibrates else LATE_MS if rng.random() < 0.3 else THROTTLE_MS
        self.throttle = Topic(rng, throttle_ms, arbiter.update_teleop)
        self._grace_ns = GRACE_NS + throttle_ms * MS
        lates = (PROMPT_MS,) if calibrates else (PROMPT_MS, THROTTLE_MS, LATE_MS)
        self.mode = Topic(rng, rng.choice(lates), arbiter.update_mode)
        self.human = Topic(rng, rng.choice(lates), arbiter.update_human)
        self.has_odometry = rng.random() < 0.8
        self.gear, self.value = "drive", 0.0
        self.now_ns = 0
        self._sent = None
        self._by_hand_ns = self._planner_ns = -S
        self._speed_mps = 0.0
        self.backward, self.faster = [], []  # when a pull drove it so under a planner's deadman
        self.overrides = self.reversed_by_hand = 0  # ticks

    def hold(self, seconds, stick, buttons):
        until_ns = self.now_ns + round(seconds * S)
        pressed = [int(button in buttons) for button in range(3)]
        while self.now_ns < until_ns:
            self.now_ns += TICK_NS
            if self.now_ns % (20 * MS) == 0:
                self.gamepad.update((0.0, stick), pressed, self.now_ns)
            self._publish(self.now_ns)
            self._run(self.now_ns)

    def _publish(self, now_ns):
        """As the node does: what differs at once, all of it 50 times a second, and the mode 10 times."""
        before, requests = self._sent, self.gamepad.requests(now_ns)
        differs = before is None or before.differs_by != requests.differs_by
        if before is None or before.mode != requests.mode or now_ns % (100 * MS) == 0:
            self.mode.send(requests.mode, now_ns)
        if differs or now_ns % (20 * MS) == 0:
            self.throttle.send(requests.throttle, now_ns)
            self.human.send(requests.human_in_loop, now_ns)
            self._sent = requests
        if requests.human_in_loop and requests.mode in HUMAN_DRIVES:
            self._by_hand_ns = now_ns

    def _run(self, now_ns):
        control = self.control
        for topic in (self.throttle, self.mode, self.human):
            topic.tick(now_ns)
        self.chip.tick(now_ns)
        self.car.step(TICK_NS / S, self.virtual.step(self.chip.duty, now_ns, self.car.wheel_mps))
        if now_ns % (20 * MS) == 0:
            control.arbiter.update_steering(TELEOP, "", now_ns)
            control.arbiter.update_planner_state(self.gear, None, now_ns)
            control.update_planner(self.value, now_ns)
            if self.has_odometry:
                control.update_odometry(self.car.wheel_mps, now_ns, 0)
            decision = control.decide(now_ns)
            self.overrides += decision.arbitration.cause == "override"
            self.reversed_by_hand += decision.esc.state == "REVERSE" and decision.arbitration.source == TELEOP
            if decision.arbitration.source != TELEOP and self.gear == "reverse":
                self._planner_ns = now_ns
            self.chip.command(decision.esc.fraction, now_ns)
        self._judge(now_ns)

    def _judge(self, now_ns):
        speed_mps, before_mps, self._speed_mps = self.car.speed_mps, self._speed_mps, self.car.speed_mps
        if now_ns - max(self._by_hand_ns, self._planner_ns) <= self._grace_ns:
            return
        if self.virtual._motor.push < 0 and speed_mps < 0.05:
            self.backward.append(now_ns / S)
        if speed_mps < before_mps and speed_mps < -0.05:
            self.faster.append(now_ns / S)

    def act(self):
        rng = self.rng
        buttons = rng.choice((BY_PLANNER, BY_PLANNER, BY_PLANNER, BY_PLANNER, (THIRD,), (AUTONOMOUS, THIRD), BY_HAND,
                              (MANUAL, AUTONOMOUS), NOBODY))
        stick = rng.choice((0.0, 0.0, rng.uniform(-1, 1), -1.0, -rng.uniform(0.05, 1)))
        kind = rng.randrange(7)
        if kind <= 1:
            self.hold(rng.uniform(0.05, 1.5), stick, buttons)
        elif kind == 2:
            self._pull_often(buttons)
        elif kind == 3:
            self._reverse_by_hand_then(buttons)
        elif kind == 4:
            self.value = rng.choice((0.0, rng.uniform(0.5, 3), -rng.uniform(0.5, 3)))
            self.hold(rng.uniform(0.1, 2.0), 0.0, BY_PLANNER)
        elif kind == 5 and not self.control.esc_config.calibration_drive:
            self.mode.is_cut = True
            self._pull_often(buttons)
            self.mode.is_cut = False
        else:
            self._reverse_by_planner()

    def _pull_often(self, buttons):
        """From half a second on: what is pulled twice within that may overtake the mode."""
        rng = self.rng
        for _ in range(rng.randrange(2, 6)):
            self.hold(rng.choice((0.04, 0.1, 0.5, 1.5)), -rng.uniform(0.15, 1.0), buttons)
            self.hold(rng.choice((0.04, 0.1, 0.3, 0.6, 1.0)), 0.0, buttons)

    def _reverse_by_hand_then(self, buttons):
        """Pull twice by hand, and have the planner's deadman anywhere in between."""
        rng = self.rng
        steps = [(-1.0, BY_HAND), (0.0, BY_HAND), (-1.0, BY_HAND), (0.0, BY_HAND)]
        change = rng.randrange(1, len(steps))
        for number, (stick, held) in enumerate(steps):
            self.hold(rng.choice((0.06, 0.2, 0.7)), stick, held if number < change else buttons)
        if rng.random() < 0.5:
            self.hold(rng.choice((0.02, 0.1)), 0.0, NOBODY)
        self._pull_often(buttons)

    def _reverse_by_planner(self):
        rng = self.rng
        self.gear, self.value = "reverse", -rng.uniform(1.0, 3.0)
        self.hold(rng.uniform(1.0, 4.0), 0.0, BY_PLANNER)
        if rng.random() < 0.7:
            self._pull_often(BY_PLANNER)
        else:
            self.hold(rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.0), BY_PLANNER)
        self.gear, self.value = "drive", 0.0

    def drive(self):
        self.hold(2.0, 0.0, NOBODY)
        for _ in range(self.rng.randrange(4, 10)):
            self.act()
        return self


@pytest.mark.once
def test_pull_under_a_planner_s_deadman_never_drives_backward():
    drives = [Drive(seed).drive() for seed in range(DRIVES)]
    assert [(seed, drive.backward[:3], drive.faster[:3]) for seed, drive in enumerate(drives)
            if drive.backward or drive.faster] == []
    assert sum(drive.overrides for drive in drives) > 20 * DRIVES, "too few overrides"
    assert sum(drive.reversed_by_hand > 0 for drive in drives) > DRIVES / 10, "too few reversals by hand before"
