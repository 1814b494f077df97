"""The questions on wheels, sonars and the Teensy: they measure what a person's hands do."""
from __future__ import annotations

import math

from car_interface.tools.first_check.question import ENTER, HUB, LEARNED, Question, Result

MIN_PULSES = 5  # less is a wheel that was touched
TURN_TOLERANCE = 0.25  # of the pulses of one turn by hand
NEAR_M, NEAR_REPORTS = 0.4, 3  # a hand


class WheelSensor(Question):
    """One rear wheel, turned by hand."""

    help = "Enter it is done"

    SIDES = ("left", "right")

    def __init__(self, car, side: int):
        super().__init__(car)
        self._side, self._name = side, self.SIDES[side]
        self.title = f"the sensor of the {self._name} rear wheel"
        self._before = tuple(car.pulses)
        self.keys = {"y": self._done, ENTER: self._done, "n": self._done}

    def missing(self, now_ns):
        return "" if not self.car.wheels.is_stale(now_ns) else "no wheel is heard: is the Teensy plugged in?"

    @property
    def text(self):
        return (f"Let go of the gamepad. Turn the {self._name.upper()} rear wheel by hand, one full turn, as when the "
                "car drives FORWARD. It doesn't matter if the other one turns back.")

    def seen(self, now_ns):
        return ", ".join(f"{name} {count:+d}" for name, count in zip(self.SIDES, self._counts())) + " pulses"

    def _counts(self):
        return [now - before for now, before in zip(self.car.pulses, self._before)]

    def _done(self, now_ns):
        if not self.car.human.is_stale(now_ns) and self.car.human.value:
            self.note = "let go of the deadman first, and begin again with A"
            return
        ours, other = self._counts()[self._side], self._counts()[1 - self._side]
        expected = self.setup.pulses_per_revolution
        if max(abs(ours), abs(other)) < MIN_PULSES:
            self._broken("it counts nothing", "look at the sensor's plug, and at its distance from the magnets")
        elif other >= MIN_PULSES > ours:
            self._broken(f"the other sensor counts it ({self.seen(now_ns)})", "exchange the plugs of the two sensors")
        elif ours <= -MIN_PULSES:
            self._broken(f"it counts backward ({ours} pulses)", "exchange the two signal wires of this sensor")
        elif ours < MIN_PULSES:
            self._broken(f"it counts too little ({self.seen(now_ns)})", "look at the sensor's plug and magnets")
        elif abs(ours - expected) > TURN_TOLERANCE * expected:
            self._broken(f"{ours} pulses in one turn", f"count a turn once more: pulses_per_revolution in "
                                                       f"teensy_sensor_hub.yaml is {expected}")
        else:
            self._fine(f"it counts forward, {ours} pulses in one turn")


class Sonar(Question):
    """One sonar, by a hand before it."""

    help = "N nothing happens   X the car has no such sonar"

    def __init__(self, car, name: str):
        super().__init__(car)
        self.name, self._words = name, name.replace("_", " ")
        self.title = f"the sonar {self._words}"
        self._reports: dict[str, int] = {}
        self._was_free: set[str] = set()
        self._counted = dict(car.range_reports)
        self.keys = {"n": self._nothing, "x": self._absent}

    def missing(self, now_ns):
        is_heard = any(not timed.is_stale(now_ns) for timed in self.car.ranges.values())
        return "" if is_heard else "no sonar is heard: is the Teensy plugged in?"

    @property
    def text(self):
        return (f"Hold your hand 20 cm in front of the sonar {self._words.upper()}, and nothing near the others. It "
                "goes on by itself.")

    def seen(self, now_ns):
        near = [name.replace("_", " ") for name, reports in self._reports.items() if reports]
        timed = self.car.ranges[self.name]
        own = timed.stale_reason(now_ns) if timed.is_stale(now_ns) else f"it sees {_range_text(timed.value)}"
        first = "; take the hand away first" if timed.was_received and timed.value < NEAR_M and not near else ""
        return f"{own}; near: {', '.join(near) or 'nothing'}{first}"

    def step(self, now_ns):
        for name, timed in self.car.ranges.items():
            if self.car.range_reports[name] == self._counted[name]:
                continue
            self._counted[name] = self.car.range_reports[name]
            is_near = timed.value < NEAR_M
            if not is_near:
                self._was_free.add(name)
            self._reports[name] = self._reports.get(name, 0) + 1 if is_near and name in self._was_free else 0
        if self._reports.get(self.name, 0) >= NEAR_REPORTS:
            self._fine(f"it sees the hand: {_range_text(self.car.ranges[self.name].value)}")

    def _nothing(self, now_ns):
        others = [name for name, reports in self._reports.items() if reports >= NEAR_REPORTS]
        timed = self.car.ranges[self.name]
        if others:
            self._broken(f"{others[0].replace('_', ' ')} sees the hand in its place",
                         f"exchange the plugs of {self._words} and {others[0].replace('_', ' ')}")
        elif timed.is_stale(now_ns):
            self._broken("it isn't heard", "look at its plug, and at sonar_sequence in teensy_sensor_hub.yaml")
        elif timed.value < NEAR_M and self.name not in self._was_free:
            self._broken(f"it always sees something: {_range_text(timed.value)}",
                         "look for what is in its cone: the box, a cable, the body")
        else:
            self._broken("it sees no hand", "look at its plug (trigger and echo), and at its aim")

    def _absent(self, now_ns):
        self.result = Result(LEARNED, "the car has none", {HUB: {"absent": (self.name,)}},
                             f"with obstacle_stop set obstacle/sonars/{self.name}: absent in throttle.yaml")


def _range_text(range_m):
    """Return a range in words; REP-117: inf = nothing, −inf = too near to be measured."""
    if math.isinf(range_m):
        return "nothing" if range_m > 0 else "something too near"
    return f"{range_m:.2f} m"


class TeensyUnplugged(Question):
    """The Teensy's cable, pulled and plugged in again."""

    title = "unplugging the Teensy"

    def __init__(self, car):
        super().__init__(car)
        self._was_lost = False
        self.keys = {"n": self._nothing}

    def missing(self, now_ns):
        return "" if self.car.link.was_received else "teensy_sensor_hub isn't heard"

    @property
    def text(self):
        if self._was_lost:
            return "It was noticed. Plug it in again; it goes on by itself."
        return "Pull the Teensy's USB cable (one that is soldered on: S). It goes on by itself."

    @property
    def help(self):
        return "N it is back, and nothing happens" if self._was_lost else "N it is unplugged, and nothing happens"

    def seen(self, now_ns):
        link = self.car.link
        return link.stale_reason(now_ns) if link.is_stale(now_ns) else f"the port is {'' if link.value else 'not '}open"

    def step(self, now_ns):
        is_there = not self.car.link.is_stale(now_ns) and self.car.link.value
        if not self._was_lost:
            self._was_lost = not is_there
        elif is_there and not self.car.wheels.is_stale(now_ns):
            self._fine("noticed, and its wheels were heard again")

    def _nothing(self, now_ns):
        if self._was_lost:
            self._broken("it doesn't come back", "rosrun car_interface setup_hardware, and port:=/dev/serial/by-id/… "
                                                 "in the launch: the port has another name now")
        else:
            self._broken("it wasn't noticed", "another device is opened: look at port:=…, rosrun car_interface doctor")
