"""Random drives of virtual ESCs through the ESC's state machine, with all that goes wrong between them.

A drive is a script of a person and a planner through a world with delays, lost speed, a guard that puts the chip to
neutral, a board that loses its power and a node that restarts; it depends on its seed alone. What the driver meant is
judged by the script, and what the car did by the virtual ESC: neither asks the state machine.
"""
from __future__ import annotations

import collections
import random
from dataclasses import dataclass, field

import virtual_escs
from esc_car import EscCar, EscCarConfig
from many_drives import MS, count_duty

from car_interface.sim import esc as virtual
from car_interface.throttle.esc import Esc
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.esc_intention import AUTO, DRIVE, REVERSE_GEAR, Request

TICK_NS = 10 * MS
STEP_NS = 20 * MS  # the arbiter's timer
# From a request to the last pulse of the one before: the timer, the way to the chip, and a PWM period.
GRACE_NS = 80 * MS
KNOWN, STALE, UNKNOWN = "known", "stale", "unknown"
SPEEDS = (KNOWN, STALE, UNKNOWN)
MATCHING, WRONG, UNVERIFIED = "matching", "wrong", "unverified"
DRIVERS = (virtual_escs.xl5, virtual_escs.vxl, virtual_escs.crawler, virtual_escs.direct, virtual_escs.race)
PROFILES = ("brake_then_reverse", "brake_becomes_reverse", "direct_reverse", "forward_only")
# A reversal that a wrong profile starts: how long the car may be driven backward.
MAX_WRONG_NS = 500 * MS


@dataclass
class Result:
    seed: int
    case: str
    unintended: list = field(default_factory=list)  # pushes backward that nobody meant
    by_stop: list = field(default_factory=list)  # those during a stop
    longest_ns: int = 0  # the longest of them, while the car moved backward
    wanted: int = 0  # reversals that had to come about
    got: int = 0
    states: collections.Counter = field(default_factory=collections.Counter)


class Chip:
    """The servo board's output for the ESC, and what it says of it."""

    def __init__(self, rng, esc):
        self._rng, self._esc = rng, esc
        self.neutral = count_duty(esc.neutral_duty)
        self.duty = self.neutral
        self._commands, self._messages = collections.deque(), collections.deque()
        self._newest, self._command_ns = self.neutral, 0
        self._published, self._published_ns = None, 0
        self.guard_until_ns = self.dead_until_ns = 0

    def command(self, fraction, now_ns):
        duty = self._esc.neutral_duty + abs(fraction) * self._full(fraction > 0)
        self._commands.append((now_ns + self._rng.randrange(1, 10) * MS, count_duty(duty)))

    def fraction(self, duty):
        if duty is None:
            return None
        forward = duty > self._esc.neutral_duty
        return (duty - self._esc.neutral_duty) / self._full(forward) * (1 if forward else -1)

    def _full(self, forward):
        esc = self._esc
        return (esc.full_forward_duty if forward else esc.full_reverse_duty) - esc.neutral_duty

    def tick(self, now_ns):
        """Return what arrives at the node now."""
        while self._commands and self._commands[0][0] <= now_ns:
            self._command_ns, self._newest = self._commands.popleft()
        if now_ns < self.dead_until_ns:
            self.duty = None
        elif now_ns < self.guard_until_ns or now_ns - self._command_ns > 250 * MS:
            self.duty = self.neutral
        else:
            self.duty = self._newest
        if self.duty != self._published or now_ns - self._published_ns >= 1000 * MS:
            self._published, self._published_ns = self.duty, now_ns
            delay_ns = self._rng.randrange(1, 60) * MS
            if self.duty is None:
                delay_ns = self._rng.randrange(1, 500) * MS  # the board is polled twice a second
            send(self._messages, now_ns + delay_ns, self.fraction(self.duty))
        return arrived(self._messages, now_ns)


def send(messages, at_ns, message):
    """Have a message arrive, and none before another that was sent before it."""
    messages.append((max(messages[-1][0] if messages else 0, at_ns), message))


def arrived(messages, now_ns):
    """Return those that have arrived by now."""
    found = []
    while messages and messages[0][0] <= now_ns:
        found.append(messages.popleft()[1])
    return found


class Drive:
    """One drive: a world, a driver, the state machine, and what came of it."""

    def __init__(self, seed):
        self.rng = rng = random.Random(seed)
        self.speed = SPEEDS[seed % 3]
        self.kind = (MATCHING, MATCHING, WRONG, UNVERIFIED)[seed // 3 % 4]
        esc = DRIVERS[seed // 12 % 5](
            dwell_s=rng.uniform(0.1, 0.4), brake_seen_s=rng.uniform(0.0, 0.1), turn_s=rng.uniform(0.0, 0.3),
            neutral_duty=rng.uniform(4800, 5030), forward_band_duty=rng.uniform(40, 110),
            reverse_band_duty=rng.uniform(40, 110), drag_brake=rng.choice((0.0, 0.05, 0.3)),
            arming_s=rng.uniform(0.1, 0.9), rearms=rng.random() < 0.7, cutoff_s=rng.uniform(0.05, 0.5),
            second_pull=rng.choice((virtual.REVERSES, virtual.BRAKES, virtual.BRAKES_AND_TURNS)),
            forget_s=rng.choice((0.0, 0.0, rng.uniform(1.0, 3.0))), starts_ready=rng.random() < 0.3)
        self.virtual = virtual.VirtualEsc(esc, rng.randrange(20) * MS)
        lock = rng.choice((None, rng.uniform(1.5, 6.0)))
        self.car = EscCar(EscCarConfig(brake_mps2=rng.uniform(4, 8), reverse_mps2=rng.uniform(2.5, 5),
                                       **({} if lock is None else {"lock_mps2": lock})))
        profile = esc.kind
        if self.kind == WRONG:
            profile = rng.choice([name for name in PROFILES if name != esc.kind])
        elif self.kind == UNVERIFIED:
            profile = UNVERIFIED
        measured = self.kind == MATCHING and rng.random() < 0.5
        self.config = EscConfig(
            profile=profile, profile_measured=measured, dwell_s=0.5 if rng.random() < 0.5 else 0.42,
            reverse_after_neutral_s=0.9 * esc.forget_s if self.kind == MATCHING or rng.random() < 0.5 else 0.0,
            stop_brake=rng.choice((0.3, 0.5, 1.0)))
        self.chip = Chip(rng, esc)
        self.esc = Esc(self.config)
        self.now_ns = 0
        self.request = Request(is_stop=True)
        self._intended_ns, self._stopped_ns, self._push_began_ns = -10**12, None, None
        self._mute_until_ns = self._moved_ns = self._node_back_ns = 0
        self._speeds = collections.deque()
        self._next_step_ns = rng.randrange(20) * MS
        self._faults = True
        self._pulled = self._meant = False  # what the driver meant
        self.result = Result(seed, f"{esc.kind} as {profile} ({self.kind}), speed {self.speed}")

    def run_for(self, seconds, request, meant=False):
        self.request, self._meant = request, meant
        until_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < until_ns:
            self.tick()

    def tick(self):
        self.now_ns += TICK_NS
        now_ns, rng = self.now_ns, self.rng
        if self._faults:
            self._fail(now_ns)
        fractions = self.chip.tick(now_ns)
        motor = self.virtual.step(self.chip.duty, now_ns, self.car.wheel_mps)
        self.car.step(TICK_NS / 1e9, motor)
        if self.speed != UNKNOWN and now_ns >= self._mute_until_ns and now_ns % (20 * MS) == 0:
            noise = rng.gauss(0, 0.01) if self.car.wheel_mps else 0.0
            send(self._speeds, now_ns + rng.randrange(1, 40) * MS, self.car.wheel_mps + noise)
        alive, speeds_mps = now_ns >= self._node_back_ns, arrived(self._speeds, now_ns)
        if alive:
            for fraction in fractions:
                self.esc.update_held(fraction, now_ns)
            for speed_mps in speeds_mps:
                self.esc.update_speed(speed_mps, now_ns)
        if alive and now_ns >= self._next_step_ns:
            self._next_step_ns = now_ns + STEP_NS
            decision = self.esc.step(self.request, now_ns)
            self.chip.command(decision.fraction, now_ns)
            self.result.states[decision.state_name] += 1
        self._judge(motor, now_ns)

    def _fail(self, now_ns):
        rng = self.rng
        if rng.random() < 0.003:
            self.chip.guard_until_ns = now_ns + rng.randrange(10, 1000) * MS
        if rng.random() < 0.0005:
            self.chip.dead_until_ns = now_ns + rng.randrange(20, 1500) * MS
        if rng.random() < 0.0005:
            self._node_back_ns = now_ns + rng.randrange(20, 1500) * MS
            self.esc = Esc(self.config)
            self._pulled = False
        if self.speed == STALE and rng.random() < 0.005:
            self._mute_until_ns = now_ns + rng.randrange(100, 3000) * MS

    def _judge(self, motor, now_ns):
        # Nothing that is sent arrives at an ESC without pulses, nor comes from a node that is away.
        is_cut_off = self.chip.duty is None or now_ns < self._node_back_ns and self.chip.duty != self.chip.neutral
        if self._meant or is_cut_off:
            self._intended_ns = now_ns
        if is_cut_off:
            self._stopped_ns = None
            return
        if not self.request.is_stop:
            self._stopped_ns = None
        elif self._stopped_ns is None:
            self._stopped_ns = now_ns
        pushed = motor.mode == virtual.BACKWARD and motor.level > 0 and self.car.speed_mps < 0.05
        if not pushed or now_ns - self._intended_ns <= GRACE_NS:
            self._push_began_ns = None
            return
        if self._push_began_ns is None:
            self._push_began_ns = now_ns
            self.result.unintended.append(f"{now_ns / 1e9:.2f} s: {self.request}")
        if self.car.speed_mps > -0.1:
            self._moved_ns = now_ns  # slower than that it stands, to the odometry
        self.result.longest_ns = max(self.result.longest_ns, now_ns - max(self._moved_ns, self._push_began_ns))
        if self._stopped_ns is not None and now_ns - self._stopped_ns > GRACE_NS:
            self.result.by_stop.append(f"{now_ns / 1e9:.2f} s")

    def stop(self, seconds, stick=0.0):
        """The deadman is released, the stick stays."""
        self._pulled = False
        self.run_for(seconds, Request(stick, is_human=True, is_stop=True, is_released=True,
                                      is_centered=abs(stick) < 0.05))

    def stick(self, value, seconds):
        """A person's stick. The second pull after the center means reverse."""
        meant = False
        if value > 0:
            self._pulled = False
        elif value < 0:
            was_pull = self.request.value < 0 and self.request.gear == AUTO and not self.request.is_stop
            if was_pull and self.request.is_human:
                meant = self._meant  # the same pull, farther or nearer
            else:
                meant = self._pulled
                self._pulled = True
        self.run_for(seconds, Request(value, is_human=True, is_centered=value == 0), meant)

    def gear(self, value, gear, seconds, is_human):
        """A planner's request, or a person's with the reverse button."""
        self._pulled = False
        self.run_for(seconds, Request(value, gear, is_human, is_centered=True), gear == REVERSE_GEAR and value < 0)

    def arm(self):
        self.stop(1.3)
        self.stick(0.0, 0.1)

    def act(self):
        rng = self.rng
        kind = rng.randrange(18)
        stick = self.request.value if self.request.is_human else 0.0
        if kind <= 2:
            self.stick(rng.uniform(0.1, 1.0), rng.uniform(0.1, 2.0))
        elif kind <= 4:
            self.stick(0.0, rng.choice((0.02, 0.1, 0.3, 0.6, 1.5)))
        elif kind <= 7:
            self.stick(-rng.uniform(0.1, 1.0), rng.choice((0.02, 0.1, 0.3, 0.8, 2.0)))
        elif kind == 8:
            for _ in range(rng.randrange(1, 5)):
                self.stop(rng.uniform(0.02, 0.7), stick)
                self.stick(stick, rng.uniform(0.02, 0.7))
        elif kind == 9:
            self.stop(rng.uniform(0.1, 2.5), stick)
        elif kind == 10:
            # Autoware holds a stopped car with -1.5 m/s²; the deadman is let go, and held again.
            hold = -rng.uniform(0.15, 0.6)
            self.gear(rng.uniform(0.2, 0.6), DRIVE, rng.uniform(0.5, 1.5), False)
            for _ in range(rng.randrange(1, 4)):
                self.gear(hold, rng.choice((DRIVE, AUTO)), rng.uniform(0.1, 2.0), False)
                self.stop(rng.uniform(0.02, 0.9))
            self.gear(hold, DRIVE, rng.uniform(0.1, 1.0), False)
        elif kind == 11:
            self.gear(-rng.uniform(0.1, 1.0), REVERSE_GEAR, rng.uniform(0.1, 2.5), rng.random() < 0.5)
        elif kind == 12:
            self.gear(rng.uniform(0.1, 0.6), rng.choice((DRIVE, REVERSE_GEAR)), rng.uniform(0.1, 1.0), False)
        elif kind == 13:
            self.arm()
        elif kind <= 15:
            self._pull_again()
        else:
            self._pull_after_a_coast()

    def _pull_again(self):
        """A pull, something that makes the next one a first, and that."""
        rng = self.rng
        self.stick(-rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0))
        self.stick(0.0, rng.uniform(0.05, 0.8))
        way = rng.randrange(3)
        if way == 0:
            self.stop(rng.uniform(0.02, 0.8))
        elif way == 1:
            self.stick(rng.uniform(0.1, 0.4), rng.uniform(0.05, 0.8))
        else:
            self.gear(rng.choice((0.0, 0.2)), DRIVE, rng.uniform(0.05, 0.8), False)
        if rng.random() < 0.7:
            self.stick(0.0, rng.uniform(0.02, 1.0))
        self.stick(-rng.uniform(0.3, 1.0), rng.uniform(0.5, 2.5))

    def _pull_after_a_coast(self):
        """Forward, a while in neutral, and a brake or a stop; some ESCs have forgotten by then that they drove."""
        rng = self.rng
        self.stick(rng.uniform(0.15, 0.5), rng.uniform(0.3, 1.0))
        self.stick(0.0, rng.uniform(0.5, 4.0))
        if rng.random() < 0.5:
            self.stick(-rng.uniform(0.3, 1.0), rng.uniform(0.5, 2.0))
        self.stop(rng.uniform(0.5, 1.5), self.request.value)

    def drive(self):
        """A random drive, then, if it must be possible, a reversal without faults."""
        self.arm()
        for _ in range(self.rng.randrange(3, 9)):
            self.act()
        if self.kind == MATCHING and self.speed == KNOWN and self.config.profile != "forward_only":
            self._want_reverse()
        return self.result

    def _want_reverse(self):
        self._faults = False
        self._node_back_ns = self.chip.guard_until_ns = self.chip.dead_until_ns = 0
        self.stop(1.0)
        for _ in range(300):
            if self.car.speed_mps:
                self.stop(0.1)
        self.arm()
        if self.rng.random() < 0.7:
            self.stick(0.5, self.rng.uniform(0.3, 1.0))
        self.stick(0.0, 0.05)
        value = -self.rng.uniform(0.35, 1.0)
        way = self.rng.randrange(3)
        if way == 0:
            self.stick(value, self.rng.uniform(0.1, 1.0))
            for _ in range(200):
                if self.car.speed_mps:
                    self.stick(value, 0.05)
            self.stick(0.0, self.rng.uniform(0.1, 1.0))
        for _ in range(60):
            if way == 0:
                self.stick(value, 0.1)
            else:
                self.gear(value, REVERSE_GEAR, 0.1, way == 1)
            if self.car.speed_mps < -0.3:
                break
        self.result.wanted += 1
        self.result.got += self.car.speed_mps < -0.3
        if self.car.speed_mps >= -0.3:
            self.result.unintended.append(f"no reverse at {self.now_ns / 1e9:.2f} s by way {way}")


def run(seed):
    return Drive(seed).drive()


def failure(result):
    if result.by_stop:
        return f"a stop became reverse at {result.by_stop[0]}"
    if result.got < result.wanted:
        return result.unintended[-1]
    if f"({MATCHING})" in result.case and result.unintended:
        return f"reverse that nobody meant at {result.unintended[0]}"
    if result.case.endswith(f" {KNOWN}") and result.longest_ns > MAX_WRONG_NS:
        return f"driven backward for {result.longest_ns / 1e9:.2f} s: {result.unintended[0]}"
    return ""


def summed_up(results):
    """Return what failed, and totals."""
    found, totals = [], collections.Counter()
    for result in results:
        totals.update({"drives": 1, "wanted": result.wanted, "got": result.got, "backward": bool(result.unintended)})
        totals.update({f"state {name}": number for name, number in result.states.items()})
        if failure(result):
            found.append(f"seed {result.seed}, {result.case}: {failure(result)}")
    return found, totals
