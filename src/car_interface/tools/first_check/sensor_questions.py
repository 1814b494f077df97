"""The questions on wheels, sonars and the Teensy: they measure what a person's hands do."""
from __future__ import annotations

import math

from car_interface.tools.first_check.question import ENTER, HUB, Question, broken, fine, learned

MIN_PULSES = 5  # less is a wheel that was touched
TURN_TOLERANCE = 0.25  # of the pulses of one turn by hand
NEAR_M, NEAR_REPORTS = 0.4, 3  # a hand


class WheelSensor(Question):
    """One rear wheel, turned by hand."""

    help, keys = "Enter it is done", f"{ENTER}yn"
    SIDES = ("left", "right")

    def __init__(self, car, side: int):
        super().__init__(car)
        self._side, self._before = side, tuple(car.pulses)
        self.title = f"the sensor of the {self.SIDES[side]} rear wheel"
        self.ask = (f"Let go of the gamepad. Turn the {self.SIDES[side].upper()} rear wheel by hand, one full turn, as "
                    "when the car drives FORWARD. It doesn't matter if the other one turns back.")

    def missing(self, now_ns):
        return "" if not self.car.wheels.is_stale(now_ns) else "no wheel is heard: is the Teensy plugged in?"

    def seen(self, now_ns):
        return ", ".join(f"{name} {count:+d}" for name, count in zip(self.SIDES, self._counts())) + " pulses"

    def _counts(self):
        return [now - before for now, before in zip(self.car.pulses, self._before)]

    def answer(self, key, now_ns):
        ours, other = self._counts()[self._side], self._counts()[1 - self._side]
        expected = self.setup.pulses_per_revolution
        if self.car.held_mode(now_ns) is not None:
            return "let go of the deadman first, and begin again with A"
        if max(abs(ours), abs(other)) < MIN_PULSES:
            return broken("it counts nothing", "look at the sensor's plug, and at its distance from the magnets")
        if other >= MIN_PULSES > ours:
            return broken(f"the other sensor counts it ({self.seen(now_ns)})", "exchange the plugs of the two sensors")
        if ours <= -MIN_PULSES:
            return broken(f"it counts backward ({ours} pulses)", "exchange the two signal wires of this sensor")
        if ours < MIN_PULSES:
            return broken(f"it counts too little ({self.seen(now_ns)})", "look at the sensor's plug and magnets")
        if abs(ours - expected) > TURN_TOLERANCE * expected:
            return broken(f"{ours} pulses in one turn", f"count a turn once more: pulses_per_revolution in "
                                                        f"teensy_sensor_hub.yaml is {expected}")
        return fine(f"it counts forward, {ours} pulses in one turn")


class Sonar(Question):
    """One sonar, by a hand before it."""

    help, keys = "N nothing happens   X the car has no such sonar", "nx"

    def __init__(self, car, name: str):
        super().__init__(car)
        self.name = name
        self.title = f"the sonar {_words(name)}"
        self.ask = (f"Hold your hand 20 cm in front of the sonar {_words(name).upper()}, and nothing near the others. "
                    "It goes on by itself.")
        self._reports: dict[str, int] = {}
        self._was_free: set[str] = set()
        self._counted = dict(car.range_reports)

    def missing(self, now_ns):
        is_heard = any(not timed.is_stale(now_ns) for timed in self.car.ranges.values())
        return "" if is_heard else "no sonar is heard: is the Teensy plugged in?"

    def seen(self, now_ns):
        near = [_words(name) for name, reports in self._reports.items() if reports]
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
        if self._reports.get(self.name, 0) < NEAR_REPORTS:
            return None
        return fine(f"it sees the hand: {_range_text(self.car.ranges[self.name].value)}")

    def answer(self, key, now_ns):
        others = [_words(name) for name, reports in self._reports.items() if reports >= NEAR_REPORTS]
        timed = self.car.ranges[self.name]
        if key == "x":
            return learned("the car has none", {HUB: {self.name: "absent"}},
                           f"with obstacle_stop set obstacle/sonars/{self.name}: absent in throttle.yaml")
        if others:
            return broken(f"{others[0]} sees the hand in its place",
                          f"exchange the plugs of {_words(self.name)} and {others[0]}")
        if timed.is_stale(now_ns):
            return broken("it isn't heard", "look at its plug, and at sonar_sequence in teensy_sensor_hub.yaml")
        if timed.value < NEAR_M and self.name not in self._was_free:
            return broken(f"it always sees something: {_range_text(timed.value)}",
                          "look for what is in its cone: the box, a cable, the body")
        return broken("it sees no hand", "look at its plug (trigger and echo), and at its aim")


def _words(name):
    return name.replace("_", " ")


def _range_text(range_m):
    """Return a range in words; REP-117: inf = nothing, −inf = too near to be measured."""
    if math.isinf(range_m):
        return "nothing" if range_m > 0 else "something too near"
    return f"{range_m:.2f} m"


class TeensyUnplugged(Question):
    """The Teensy's cable, pulled and plugged in again."""

    title = "unplugging the Teensy"
    ask = "Pull the Teensy's USB cable (one that is soldered on: S). It goes on by itself."
    help, keys = "N it is unplugged, and nothing happens", "n"
    _was_lost = False

    def missing(self, now_ns):
        return "" if self.car.link.was_received else "teensy_sensor_hub isn't heard"

    def seen(self, now_ns):
        link = self.car.link
        return link.stale_reason(now_ns) if link.is_stale(now_ns) else f"the port is {'' if link.value else 'not '}open"

    def step(self, now_ns):
        is_there = not self.car.link.is_stale(now_ns) and self.car.link.value
        if self._was_lost:
            is_heard = is_there and not self.car.wheels.is_stale(now_ns)
            return fine("noticed, and its wheels were heard again") if is_heard else None
        if not is_there:
            self._was_lost = True
            self.ask = "It was noticed. Plug it in again; it goes on by itself."
            self.help = "N it is back, and nothing happens"
        return None

    def answer(self, key, now_ns):
        if self._was_lost:
            return broken("it doesn't come back", "rosrun car_interface setup_hardware, and port:=/dev/serial/by-id/… "
                                                  "in the launch: the port has another name now")
        return broken("it wasn't noticed", "another device is opened: look at port:=…, rosrun car_interface doctor")
