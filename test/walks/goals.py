"""A monitor of the goals of docs/safety_case.md: it sees persons and the car, and nothing of what is between them.

Persons touch, let go, push e-stops; servo and ESC get pulses; the motor drives. The times are the page's. What the page
leaves open is allowed.
"""
from __future__ import annotations

from typing import NamedTuple

MS = 1_000_000
SERVO, ESC = 0, 1
BOTH = (SERVO, ESC)
SLACK_NS = 100 * MS  # messages, timers of 20 ms and a pulse, where nothing else is wrong
# All time-outs of the chain one after another (joystick 0.27 s, deadman 0.51 s, board 0.25 s), a stall that is too
# short to count (0.5 s), and what the walks put on the links.
ROUGH_NS = 2000 * MS
TRANSIT_NS = 600 * MS  # the ends of a stop and of a press may arrive in either order
TOGETHER_NS, ROUGH_TOGETHER_NS = 640 * MS, 2000 * MS  # throttle without steering
LASTING_NS = 60 * MS  # a shorter push backward moves nothing
SETTLED_NS = 400 * MS  # a stick that was moved so long ago, and the car's answer, are known everywhere
REST_NS = 200 * MS
LIMIT_MARGIN_MPS, LIMIT_NS = 0.4, 600 * MS
STANDS_MPS = 0.35  # a pull that begins below it may want reverse
DEFLECTED = 0.3


class Stop(NamedTuple):
    """Something that must stop actuators.

    Attributes:
        due_ns: when they must have stopped, at the latest.
        rearms: the deadman must be pressed anew after it.
        until_press: it ends with that.
    """

    actuators: tuple[int, ...]
    since_ns: int
    within_ns: int
    due_ns: int
    rearms: bool = True
    until_press: bool = False


class Goals:
    """Follows persons and car, and names each violated goal once in a second.

    Attributes:
        found: violations in words, with their times.
        limit_mps: of the speed; 0 = none.
    """

    def __init__(self, limit_mps: float = 0.0):
        self.found: list[str] = []
        self.limit_mps = limit_mps
        self._stops: dict[str, Stop] = {"never pressed": Stop(BOTH, 0, 0, 0, until_press=True)}
        self._armed = {SERVO: False, ESC: False}
        self._rough_until_ns = 0
        self._holders: set[str] = set()
        self._pressed_ns = 0
        self._sticks = (0.0, 0.0)
        self._sticks_ns = [0, 0]
        self._counts = [False, False]  # a stick counts once it rested under the deadman
        self._wants_reverse_ns, self._pull_wants = -ROUGH_NS, False
        self._pull_lasts_until_ns = 0
        self._speed_mps = 0.0
        self._alone_ns: int | None = None
        self._backward_ns: int | None = None
        self._fast_ns: int | None = None
        self._named_ns: dict[str, int] = {}

    # --- persons, and faults ---

    def touch(self, hand: str, deadman: str, steering: float, throttle: float, now_ns: int) -> None:
        """Take what a hand does: the deadman that it holds, and its sticks, −1 right, back .. 1 left, forward."""
        was_held, is_held = hand in self._holders, bool(deadman)
        if is_held and not was_held:
            self._press(now_ns)
            self._counts = [False, False]
        (self._holders.add if is_held else self._holders.discard)(hand)
        for index, stick in enumerate(self._sticks):
            rested_ns = now_ns - max(self._sticks_ns[index], self._pressed_ns, self._rough_until_ns)
            self._counts[index] |= was_held and is_held and not stick and rested_ns > REST_NS
        if self._holders:
            self._stops.pop("released", None)
        elif was_held:
            self.stop("released", now_ns)
        if throttle < 0 <= self._sticks[1]:
            self._pull_wants = deadman == "manual" and self._speed_mps < STANDS_MPS
        for index, (before, stick) in enumerate(zip(self._sticks, (steering, throttle))):
            if before != stick:
                self._sticks_ns[index] = now_ns
        self._sticks = steering, throttle

    def _press(self, now_ns):
        self._look_at_stops(now_ns, False, False)
        self._pressed_ns = now_ns
        self._stops = {name: stop for name, stop in self._stops.items() if not stop.until_press and name != "released"}
        for actuator in BOTH:
            if not any(actuator in stop.actuators and stop.rearms and now_ns > stop.due_ns
                       for stop in self._stops.values()):
                self._armed[actuator] = True

    def stop(self, name: str, now_ns: int, within_s: float = 0.0, actuators: tuple[int, ...] = BOTH,
             rearms: bool = True, until_press: bool = False) -> None:
        """Take note that actuators must stop: a release, an e-stop, a device or a node that is silent or starts anew.

        Args:
            within_s: the time that the page gives.
            rearms: after its end, which ``clear`` tells, the deadman must be pressed anew.
            until_press: nothing but that ends it.
        """
        if name not in self._stops:
            within_ns = round(within_s * 1e9) + SLACK_NS
            due_ns = min(now_ns + ROUGH_NS, max(now_ns, self._rough_until_ns) + within_ns)
            self._stops[name] = Stop(actuators, now_ns, within_ns, due_ns, rearms, until_press)

    def clear(self, name: str, now_ns: int) -> None:
        """Take note that what ``stop`` named is over."""
        self._look_at_stops(now_ns, False, False)
        stop = self._stops.pop(name, None)
        if stop is not None and stop.rearms and now_ns - self._pressed_ns <= TRANSIT_NS:
            self._press(self._pressed_ns)

    def waive(self, name: str) -> None:
        """Take note that nothing stops for what ``stop`` named any more, by a risk that the page names."""
        self._stops.pop(name, None)

    def rough(self, until_ns: int, but: str = "") -> None:
        """Take note of a fault that delays messages, or what they cause, until a time; of which ``but`` is the stop."""
        self._rough_until_ns = max(self._rough_until_ns, until_ns)
        for name, stop in self._stops.items():
            if name != but:
                due_ns = min(stop.since_ns + ROUGH_NS, max(stop.due_ns, until_ns + stop.within_ns))
                self._stops[name] = stop._replace(due_ns=due_ns)

    def hold_pull(self, until_ns: int) -> None:
        """Take note of a fault by which a pull outlasts the braking until a time, as R2 and R11 say."""
        self._pull_lasts_until_ns = max(self._pull_lasts_until_ns, until_ns)

    def distrust(self) -> None:
        """Take note that the sticks were unreadable: they count once they are centered."""
        self._counts = [False, False]

    # --- the car ---

    def look(self, now_ns: int, servo: int, esc: int, is_together: bool, drives: int, speed_mps: float) -> None:
        """Judge what the car does from now on.

        Args:
            servo: the side of its pulses: −1 right, 0 center or none, 1 left.
            esc: −1 a pull, 0 neutral or none, 1 a push.
            is_together: the servo has what turn_arb commands.
            drives: where to the motor drives the car: −1 backward, 0 nowhere, or it brakes, 1 forward.
        """
        self._speed_mps = speed_mps
        self._look_at_stops(now_ns, bool(servo), esc > 0)
        self._look_together(now_ns, esc, is_together)
        self._look_backward(now_ns, drives)
        self._look_at_sticks(now_ns, servo, esc)
        self._look_at_limit(now_ns, esc, speed_mps)

    def _look_at_stops(self, now_ns, steers, pushes):
        for actuator, moves in ((SERVO, steers), (ESC, pushes)):
            for name, stop in self._stops.items():
                if actuator in stop.actuators and now_ns > stop.due_ns:
                    self._armed[actuator] &= not stop.rearms or name == "released"
                    if moves:
                        self._name(now_ns, f"G1: {('servo', 'ESC')[actuator]} {(now_ns - stop.since_ns) / 1e9:.3f} s "
                                           f"after: {name}")
            if moves and not self._armed[actuator]:
                self._name(now_ns, f"G1: {('servo', 'ESC')[actuator]} without re-arming")

    def _look_together(self, now_ns, esc, is_together):
        if esc <= 0 or is_together:
            self._alone_ns = None
            return
        self._alone_ns = now_ns if self._alone_ns is None else self._alone_ns
        is_rough = self._alone_ns < self._rough_until_ns + SLACK_NS
        if now_ns - self._alone_ns > (ROUGH_TOGETHER_NS if is_rough else TOGETHER_NS):
            self._name(now_ns, "G3: throttle without steering")

    def _look_backward(self, now_ns, drives):
        if self._holders and self._sticks[1] < 0 and self._pull_wants:
            self._wants_reverse_ns = now_ns
        if drives >= 0 or now_ns - self._wants_reverse_ns <= ROUGH_NS or now_ns <= self._pull_lasts_until_ns:
            self._backward_ns = None
            return
        self._backward_ns = now_ns if self._backward_ns is None else self._backward_ns
        if now_ns - self._backward_ns > LASTING_NS:
            self._name(now_ns, "G2: it drives backward")

    def _look_at_sticks(self, now_ns, servo, esc):
        is_calm = now_ns - max(self._rough_until_ns, self._pressed_ns) > SETTLED_NS
        if not (is_calm and self._holders):
            return
        steering, throttle = self._sticks
        if (self._counts[0] and abs(steering) > DEFLECTED and now_ns - self._sticks_ns[0] > SETTLED_NS
                and servo * steering < 0):
            self._name(now_ns, "G4: the servo turns against the stick")
        if (self._counts[1] and throttle < -DEFLECTED and now_ns - self._sticks_ns[1] > SETTLED_NS and esc > 0):
            self._name(now_ns, "G4: throttle against a pull")

    def _look_at_limit(self, now_ns, esc, speed_mps):
        is_fast = self.limit_mps and esc > 0 and speed_mps > self.limit_mps + LIMIT_MARGIN_MPS
        if not is_fast or now_ns - self._rough_until_ns < LIMIT_NS:
            self._fast_ns = None
            return
        self._fast_ns = now_ns if self._fast_ns is None else self._fast_ns
        if now_ns - self._fast_ns > LIMIT_NS:
            self._name(now_ns, f"G5: throttle at {speed_mps:.2f} m/s")

    def outlives(self, now_ns: int, actuator: int, age_ns: int) -> None:
        """Take how long ago the newest command arrived at the board by which an actuator is not at neutral."""
        if age_ns > 250 * MS + 40 * MS:
            self._name(now_ns, f"G6: {('servo', 'ESC')[actuator]} by a command of {age_ns / 1e9:.3f} s ago")

    def explain(self, now_ns: int, is_at_rest: bool, cause: str) -> None:
        """Take the cause that is published with a command."""
        if is_at_rest and not cause:
            self._name(now_ns, "G7: stopped without a cause")

    def _name(self, now_ns, text):
        kind = text[:8]
        if now_ns - self._named_ns.get(kind, -10**12) > 1000 * MS:
            self.found.append(f"{now_ns / 1e9:.3f} s {text}")
        self._named_ns[kind] = now_ns
