"""The questions on the steering, in which this program steers while a person holds the autonomous deadman."""
from __future__ import annotations

from car_interface.common.causes import MANUAL
from car_interface.common.units import NS_PER_S
from car_interface.tools.first_check.car import SAME_DUTY
from car_interface.tools.first_check.question import ENTER, GAMEPAD, STEERING, Question, broken, fine, learned, skipped

FULL_STICK = 0.8  # held at its end
CENTER_STEP, END_STEP = 0.01, 0.05  # of a side's travel
MAX_CENTER = 0.4  # farther off, the servo's horn sits wrong: one of its 25 teeth is 14.4°, 0.32 of a side's 45°
MIN_END = 0.3  # nearer ends leave a car that hardly turns
SAFE_WITHIN_NS, BACK_WITHIN_NS = 2 * NS_PER_S, 20 * NS_PER_S  # a launch file restarts a node after 1 s
NOT_HELD = "hold it, and type then"


class SteeringDirection(Question):
    """The stick and the servo, each to the left: by the stick's sign, and by a person's eyes."""

    title = "the steering's direction"
    ask = "{manual} and the left stick fully to the LEFT. Where do the front wheels point, seen from behind the car?"
    help, keys = "L to the left   R to the right   N nowhere, they don't move", "lrn"
    _full, _duty = 0.0, None  # the stick when it was last at its end, and the servo's duty then

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

    def answer(self, key, now_ns):
        channel, stick_is_left = self.setup.steering.servo_channel, self._full > 0
        if not self._full:
            return "hold deadman and stick first"
        if key == "n":
            return broken(f"the front wheels don't move; the servo board's channel {channel} has duty {self._duty}",
                          f"look at the servo's plug (channel {channel}), its power (the ESC's BEC) and its horn")
        changes: dict = {}
        if not stick_is_left:
            changes[GAMEPAD] = {"steer_scale": -self.setup.steer_scale}
        if (key == "l") != stick_is_left:
            changes[STEERING] = {"exchanged": True}
        if not changes:
            return fine("stick and wheels go to the same side")
        wrong = " and ".join(["the stick"] * (GAMEPAD in changes) + ["the servo"] * (STEERING in changes))
        return learned(f"{wrong} went the other way", changes)


class _Steers(Question):
    """This program steers, while the autonomous deadman is held."""

    def __init__(self, car):
        super().__init__(car)
        self.steering = car.center
        self._left = -1 if car.is_exchanged else 1  # the sign of a request to the left

    def seen(self, now_ns):
        return self.car.by_program(now_ns) or f"the duty is {self.car.steering.value.duty}"


class _Finds(_Steers):
    """A person turns the wheels by two keys to a place that is asked for."""

    keys = f",.{ENTER}yn"
    step_size = END_STEP  # of the request, with each key
    low, high = -1.0, 1.0
    failure = ("", "")  # answer and repair where the place can't be reached

    def answer(self, key, now_ns):
        if key == "n":
            return broken(*self.failure)
        if self.car.by_program(now_ns):
            return NOT_HELD
        if key not in ",.":
            return self._conclude(self.setup.steering.teleop_duty(self.steering))
        wanted = round(self.steering + (1 if key == "," else -1) * self._left * self.step_size, 3)
        self.steering = max(self.low, min(self.high, wanted))
        return None

    def _conclude(self, duty):
        """Return the answer that a duty is the place, or why it can't be."""
        raise NotImplementedError


class Center(_Finds):
    """Straight ahead."""

    title = "the steering's center"
    ask = "{autonomous}. Do the front wheels point straight ahead? If not, turn them with < and > until they do."
    help = "< a little left   > a little right   Enter they are straight   N they can't be"
    step_size = CENTER_STEP
    low, high = -MAX_CENTER, MAX_CENTER
    failure = ("the wheels can't be made straight",
               "put the servo's horn one tooth further, or set the length of the tie rods; then check again")

    def _conclude(self, duty):
        center = self.setup.steering.servo_center
        if abs(duty - center) <= SAME_DUTY:
            return fine(f"straight at duty {center}")
        return learned(f"straight at duty {duty}", {STEERING: {"servo_center": duty}})


class End(_Finds):
    """The farthest that the wheels turn to one side, 1 left or −1 right."""

    help = "< to the left   > to the right   Enter that is the end   N they don't turn"

    def __init__(self, car, side: int):
        super().__init__(car)
        self._name, key = ("left", "<") if side > 0 else ("right", ">")
        self.title = f"the steering's {self._name} end"
        self.ask = (f"{{autonomous}}. Turn the front wheels to the {self._name} with {key}, until they turn no "
                    "further, a tyre touches something or the servo hums; then one or two steps back.")
        self.low, self.high = (car.center, 1.0) if side * self._left > 0 else (-1.0, car.center)
        self.failure = (f"the front wheels don't turn to the {self._name} far enough",
                        "look for what blocks the steering, and at the servo's horn")

    def _conclude(self, duty):
        if abs(self.steering - self.car.center) < MIN_END:
            return "that is hardly a turn: go further, or type N"
        if abs(self.steering) >= 1.0:
            return fine(f"free up to the end of the file, duty {duty}")
        return learned(f"the end is at duty {duty}", {STEERING: {f"servo_{self._name}": duty}})


class BoardKilled(_Steers):
    """The servo board's node, killed while it steers: the guard has to center."""

    title = "killing the servo board's node"
    ask = ("{autonomous}: the front wheels turn to the left. Then K kills the node of the servo board (kill -9): its "
           "guard must center them, and the launch file starts it again.")
    help, keys = "K kill it", "kyn"
    _killed_ns: int | None = None
    _node = _centered = ""  # who reported before; who centered, and when
    _is_back = False

    def __init__(self, car):
        super().__init__(car)
        self.steering = car.center + 0.5 * self._left
        self._channel = self.setup.steering.servo_channel

    def seen(self, now_ns):
        if self._killed_ns is None:
            return super().seen(now_ns)
        return f"channel {self._channel} has duty {self.car.held_duty(self._channel, now_ns)}"

    def kill_failed(self, reason: str) -> None:
        """Take note that it couldn't be killed."""
        self.result = skipped(f"it couldn't be killed: {reason}")

    def step(self, now_ns):
        if self._killed_ns is None or self._is_back:
            return None
        after_ns = now_ns - self._killed_ns
        if not self._centered and self._is_centered(now_ns):
            self._centered = f"{self.car.sender} reported the center {after_ns / NS_PER_S:.1f} s after the kill"
        if self._centered and self.car.sender == self._node:
            self._is_back, self.help = True, "Y yes   N no"
            self.ask = f"{self._centered}, and the node is back. Did the front wheels go straight?"
        elif not self._centered and after_ns > SAFE_WITHIN_NS:
            return broken("nobody centered the steering within two seconds",
                          "let the guard run: guard in pca9685.yaml; rosrun car_interface doctor")
        elif after_ns > BACK_WITHIN_NS:
            return broken("centered, but the node isn't back", "start it again by its launch file, which restarts it")
        return None

    def _is_centered(self, now_ns):
        duty = self.car.held_duty(self._channel, now_ns)
        return duty is not None and (not duty or abs(duty - self.setup.steering.servo_center) <= SAME_DUTY)

    def answer(self, key, now_ns):
        if key == "k":
            return self._kill(now_ns) if self._killed_ns is None else None
        if not self._is_back:
            return None
        if key == "y":
            return fine(f"{self._centered}, and the node came back")
        return broken("the board reports the center, and the wheels aren't there",
                      "look at the servo's plug and power; center the steering first")

    def _kill(self, now_ns):
        if self.car.by_program(now_ns):
            return NOT_HELD
        if self._is_centered(now_ns):
            return "the wheels must be turned first"
        self._killed_ns, self._node = now_ns, self.car.sender
        self.steering, self.kills_board = None, True
        self.ask, self.help = "It was killed: wait.", ""
        return None
