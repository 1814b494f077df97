"""The questions on the steering, in which this program steers while a person holds the autonomous deadman."""
from __future__ import annotations

from functools import partial

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.units import NS_PER_S
from car_interface.tools.first_check.question import (
    ENTER,
    GAMEPAD,
    LEARNED,
    SAME_DUTY,
    SKIPPED,
    STEERING,
    Question,
    Result,
)

FULL_STICK = 0.8  # held at its end
CENTER_STEP, END_STEP = 0.01, 0.05  # of a side's travel
MAX_CENTER = 0.4  # farther off, the servo's horn sits wrong: one of its 25 teeth is 14.4°, 0.32 of a side's 45°
MIN_END = 0.3  # nearer ends leave a car that hardly turns
SAFE_WITHIN_NS, BACK_WITHIN_NS = 2 * NS_PER_S, 20 * NS_PER_S  # a launch file restarts a node after 1 s


class SteeringDirection(Question):
    """The stick and the servo, each to the left: by the stick's sign, and by a person's eyes."""

    title = "the steering's direction"
    help = "L to the left   R to the right   N nowhere, they don't move"

    def __init__(self, car):
        super().__init__(car)
        self._full, self._duty = 0.0, None  # the stick when it was last at its end, and the servo's duty then
        self.keys = {"l": partial(self._turned, True), "r": partial(self._turned, False), "n": self._nothing}

    @property
    def text(self):
        return (f"{self._hold(MANUAL)} and the left stick fully to the LEFT. Where do the front wheels point, seen "
                "from behind the car?")

    def seen(self, now_ns):
        stick = self._stick(now_ns)
        if not stick:
            return "the stick was seen" if self._full else "no stick is seen"
        return f"the stick is at {abs(stick):.0%} {'left' if stick > 0 else 'right'}"

    def step(self, now_ns):
        stick = self._stick(now_ns)
        if abs(stick) >= FULL_STICK:
            self._full = stick
            self._duty = self.car.held_duty(self.setup.steering.servo_channel, now_ns)

    def _stick(self, now_ns):
        is_held = self.car.held_mode(now_ns) == MANUAL and not self.car.steering_stick.is_stale(now_ns)
        return self.car.steering_stick.value if is_held else 0.0

    def _is_ready(self):
        self.note = "" if self._full else "hold deadman and stick first"
        return not self.note

    def _turned(self, is_left, now_ns):
        if not self._is_ready():
            return
        stick_is_left = self._full > 0
        changes: dict = {}
        if not stick_is_left:
            changes[GAMEPAD] = {"steer_scale": -self.setup.steer_scale}
        if is_left != stick_is_left:
            changes[STEERING] = {"exchanged": True}
        wrong = " and ".join(["the stick"] * (GAMEPAD in changes) + ["the servo"] * (STEERING in changes))
        if changes:
            self.result = Result(LEARNED, f"{wrong} went the other way", changes)
        else:
            self._fine("stick and wheels go to the same side")

    def _nothing(self, now_ns):
        if self._is_ready():
            channel = self.setup.steering.servo_channel
            self._broken(f"the front wheels don't move; the servo board's channel {channel} has duty {self._duty}",
                         f"look at the servo's plug (channel {channel}), its power (the ESC's BEC) and its horn")


class _Steers(Question):
    """This program steers, while the autonomous deadman is held.

    Args:
        is_exchanged: servo_left turns right.
        center: the request at which the wheels point straight ahead, as far as it is known.
    """

    def __init__(self, car, is_exchanged: bool = False, center: float = 0.0):
        super().__init__(car)
        self._left, self._center = (-1 if is_exchanged else 1), center
        self.steering = center

    def seen(self, now_ns):
        return self.car.by_program(now_ns) or f"the duty is {self.car.steering.value.duty}"

    def _is_ready(self, now_ns):
        self.note = "hold it, and type then" if self.car.by_program(now_ns) else ""
        return not self.note


class _Finds(_Steers):
    """A person turns the wheels by two keys to a place that is asked for."""

    step_size = END_STEP
    low, high = -1.0, 1.0  # of the request

    def __init__(self, car, is_exchanged: bool = False, center: float = 0.0):
        super().__init__(car, is_exchanged, center)
        self.keys = {",": partial(self._move, 1), ".": partial(self._move, -1), ENTER: self._enter, "y": self._enter,
                     "n": self._no}

    def _move(self, side, now_ns):
        if self._is_ready(now_ns):
            wanted = round(self.steering + side * self._left * self.step_size, 3)
            self.steering = max(self.low, min(self.high, wanted))

    def _duty(self):
        return self.setup.steering.teleop_duty(self.steering)

    def _enter(self, now_ns):
        raise NotImplementedError

    def _no(self, now_ns):
        raise NotImplementedError


class Center(_Finds):
    """Straight ahead."""

    title = "the steering's center"
    help = "< a little left   > a little right   Enter they are straight   N they can't be"
    step_size = CENTER_STEP
    low, high = -MAX_CENTER, MAX_CENTER

    @property
    def text(self):
        return (f"{self._hold(AUTONOMOUS)}. Do the front wheels point straight ahead? If not, turn them with < and "
                "> until they do.")

    def _enter(self, now_ns):
        if not self._is_ready(now_ns):
            return
        duty = self._duty()
        if abs(duty - self.setup.steering.servo_center) <= SAME_DUTY:
            self._fine(f"straight at duty {self.setup.steering.servo_center}")
        else:
            self._learned(f"straight at duty {duty}", STEERING, servo_center=duty)

    def _no(self, now_ns):
        self._broken("the wheels can't be made straight",
                     "put the servo's horn one tooth further, or set the length of the tie rods; then check again")


class End(_Finds):
    """The farthest that the wheels turn to one side."""

    help = "< to the left   > to the right   Enter that is the end   N they don't turn"

    def __init__(self, car, side: int, is_exchanged: bool = False, center: float = 0.0):
        super().__init__(car, is_exchanged, center)
        self._side, self._name = side, "left" if side > 0 else "right"
        self.title = f"the steering's {self._name} end"
        self.low, self.high = (center, 1.0) if side * self._left > 0 else (-1.0, center)

    @property
    def text(self):
        key = "<" if self._side > 0 else ">"
        return (f"{self._hold(AUTONOMOUS)}. Turn the front wheels to the {self._name} with {key}, until they turn "
                "no further, a tyre touches something or the servo hums; then one or two steps back.")

    def _enter(self, now_ns):
        if not self._is_ready(now_ns):
            return
        if abs(self.steering - self._center) < MIN_END:
            self.note = "that is hardly a turn: go further, or type N"
        elif abs(self.steering) >= 1.0:
            self._fine(f"free up to the end of the file, duty {self._duty()}")
        else:
            self._learned(f"the end is at duty {self._duty()}", STEERING, **{f"servo_{self._name}": self._duty()})

    def _no(self, now_ns):
        self._broken(f"the front wheels don't turn to the {self._name} far enough",
                     "look for what blocks the steering, and at the servo's horn")


class BoardKilled(_Steers):
    """The servo board's node, killed while it steers: the guard has to center."""

    title = "killing the servo board's node"

    def __init__(self, car, is_exchanged: bool = False, center: float = 0.0):
        super().__init__(car, is_exchanged, center)
        self.steering = center + 0.5 * self._left
        self._killed_ns: int | None = None
        self._centered_ns: int | None = None  # so long after that
        self._by = self._node = ""  # who centered; who reported before
        self._is_back = False
        self.keys = {"k": self._kill, "y": partial(self._saw, True), "n": partial(self._saw, False)}

    @property
    def text(self):
        if self._is_back:
            return f"{self._centered_text}, and the node is back. Did the front wheels go straight?"
        if self._killed_ns is not None:
            return "It was killed: wait."
        return (f"{self._hold(AUTONOMOUS)}: the front wheels turn to the left. Then K kills the node of the servo "
                "board (kill -9): its guard must center them, and the launch file starts it again.")

    @property
    def help(self):
        if self._killed_ns is None:
            return "K kill it"
        return "Y yes   N no" if self._is_back else ""

    def seen(self, now_ns):
        if self._killed_ns is None:
            return super().seen(now_ns)
        return f"channel {self._channel} has duty {self.car.held_duty(self._channel, now_ns)}"

    @property
    def _channel(self):
        return self.setup.steering.servo_channel

    def kill_failed(self, reason: str) -> None:
        """Take note that it couldn't be killed."""
        self.result = Result(SKIPPED, f"it couldn't be killed: {reason}")

    def step(self, now_ns):
        if self._killed_ns is None:
            return
        after_ns = now_ns - self._killed_ns
        if self._centered_ns is None and self._is_centered(now_ns):
            self._centered_ns, self._by = after_ns, self.car.output.value.sender
        if self._centered_ns is not None and self.car.output.value.sender == self._node:
            self._is_back = True
        elif self._centered_ns is None and after_ns > SAFE_WITHIN_NS:
            self._broken("nobody centered the steering within two seconds",
                         "let the guard run: guard in pca9685.yaml; rosrun car_interface doctor")
        elif not self._is_back and after_ns > BACK_WITHIN_NS:
            self._broken("centered, but the node isn't back", "start it again by its launch file, which restarts it")

    @property
    def _centered_text(self):
        return f"{self._by} reported the center {self._centered_ns / NS_PER_S:.1f} s after the kill"

    def _is_centered(self, now_ns):
        duty = self.car.held_duty(self._channel, now_ns)
        return duty is not None and (not duty or abs(duty - self.setup.steering.servo_center) <= SAME_DUTY)

    def _kill(self, now_ns):
        if self._killed_ns is None and self._is_ready(now_ns):
            if self._is_centered(now_ns):
                self.note = "the wheels must be turned first"
                return
            self._killed_ns, self._node = now_ns, self.car.output.value.sender
            self.steering, self.kills_board = None, True

    def _saw(self, went_straight, now_ns):
        if not self._is_back:
            return
        if went_straight:
            self._fine(f"{self._centered_text}, and the node came back")
        else:
            self._broken("the board reports the center, and the wheels aren't there",
                         "look at the servo's plug and power; center the steering first")
