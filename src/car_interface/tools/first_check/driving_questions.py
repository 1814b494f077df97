"""The questions on steering, throttle and ESC: in some this program steers while a person holds the autonomous deadman,
in the others the person drives by the manual deadman and the right stick.
"""
from __future__ import annotations

import math

from car_interface.common.causes import MANUAL
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc import BRAKING, HOLD
from car_interface.throttle.esc_config import BRAKE_BECOMES_REVERSE, BRAKE_THEN_REVERSE, DIRECT_REVERSE, FORWARD_ONLY
from car_interface.tools.first_check.car import GAMEPAD, SAME_DUTY, STEERING, THROTTLE
from car_interface.tools.first_check.questions import ENTER, YES_NO, Question, broken, fine, first, learned, skipped

FULL_STICK = 0.8  # held at its end
CENTER_STEP, END_STEP = 0.01, 0.05  # of a side's travel
MAX_CENTER = 0.4  # farther off, the servo's horn sits wrong: one of its 25 teeth is 14.4°, 0.32 of a side's 45°
MIN_END = 0.3  # nearer ends leave a car that hardly turns
# A launch file restarts a node after 1 s. Where a node starts slowly nobody reports the board's output for a while.
SAFE_WITHIN_NS, BACK_WITHIN_NS = 2 * NS_PER_S, 20 * NS_PER_S
NOT_HELD = "hold it, and type then"
PUSHED = 0.1  # of a stick: moved on purpose
NEUTRAL_STEP, MAX_NEUTRAL = 5, 100  # duty; the second is throttle_arb's live_range
PULL_NS = NS_PER_S  # of a pull, to see what the wheels do
NEUTRAL_WITHIN_NS = NS_PER_S // 2
STOPS = (BRAKING, HOLD)


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
        return self.car.held_mode(now_ns) == MANUAL and self.car.steering_stick.fresh(now_ns) or 0.0

    def answer(self, key, now_ns):
        channel, stick_is_left = self.setup.steering.servo_channel, self._full > 0
        stick = {} if stick_is_left else {GAMEPAD: {"steer_scale": -self.setup.steer_scale}}
        servo = {} if stick_is_left == (key == "l") else {STEERING: {"exchanged": True}}
        wrong = " and ".join(["the stick"] * len(stick) + ["the servo"] * len(servo))
        return first(
            (not self._full, "hold deadman and stick first"),
            (key == "n",
             broken(f"the front wheels don't move; the servo board's channel {channel} has duty {self._duty}",
                    f"look at the servo's plug (channel {channel}), its power (the ESC's BEC) and its horn")),
            (not wrong, fine("stick and wheels go to the same side")),
            (True, learned(f"{wrong} went the other way", changes={**stick, **servo})))


class _Steers(Question):
    """This program steers, while the autonomous deadman is held."""

    def __init__(self, car):
        super().__init__(car)
        self.steering = car.center
        self._left = -1 if car.is_exchanged else 1  # the sign of a request to the left

    def seen(self, now_ns):
        return self.car.by_program(now_ns) or f"the duty is {self.car.steering.value.duty}"


class _Finds(_Steers):
    """A person turns the wheels by two keys to a place; ``_conclude`` judges a duty that is said to be it."""

    keys = f",.{ENTER}yn"
    step_size = END_STEP  # of the request, with each key
    low, high = -1.0, 1.0
    failure = ("", "")  # answer and repair where the place can't be reached

    def answer(self, key, now_ns):
        outcome = first((key == "n", broken(*self.failure)), (self.car.by_program(now_ns), NOT_HELD),
                        (key not in ",.", self._conclude(self.setup.steering.teleop_duty(self.steering))))
        if outcome is None:
            wanted = round(self.steering + (1 if key == "," else -1) * self._left * self.step_size, 3)
            self.steering = max(self.low, min(self.high, wanted))
        return outcome


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
        return first(
            (abs(duty - center) <= SAME_DUTY, fine(f"straight at duty {center}")),
            (True, learned(f"straight at duty {duty}",
                           changes={STEERING: {"servo_center": duty, "center_request": self.steering}})))


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
        return first(
            (abs(self.steering - self.car.center) < MIN_END, "that is hardly a turn: go further, or type N"),
            (abs(self.steering) >= 1.0, fine(f"free up to the end of the file, duty {duty}")),
            (True, learned(f"the end is at duty {duty}", changes={STEERING: {f"servo_{self._name}": duty}})))


class BoardKilled(_Steers):
    """The servo board's node, killed while it steers: the guard has to center."""

    title = "killing the servo board's node"
    ask = ("{autonomous}: the front wheels turn to the left. Then K kills the node of the servo board (kill -9): its "
           "guard must center them, and the launch file starts it again.")
    help, keys = "K kill it", "k"
    _killed_ns: int | None = None
    _node = _centered = ""  # who reported before; who centered, and when

    def __init__(self, car):
        super().__init__(car)
        self.steering = car.center + 0.5 * self._left
        self._channel = self.setup.steering.servo_channel

    def seen(self, now_ns):
        if self._killed_ns is None:
            return super().seen(now_ns)
        return f"channel {self._channel} has duty {self.car.held_duty(self._channel, now_ns)}"

    def step(self, now_ns):
        if self.keys:  # it is the person's turn
            return None
        after_ns = now_ns - self._killed_ns
        if not self._centered and self._is_centered(now_ns):
            self._centered = f"{self.car.sender} reported the center {after_ns / NS_PER_S:.1f} s after the kill"
        if self._centered and self.car.sender == self._node:
            self.go_on(f"{self._centered}, and the node is back. Did the front wheels go straight at once?")
            return None
        reported_after_ns = after_ns - self.car.output.silence_s(now_ns) * NS_PER_S
        return first(
            (not self._centered and reported_after_ns > SAFE_WITHIN_NS,
             broken("nobody centered the steering within two seconds",
                    "let the guard run: guard in pca9685.yaml; rosrun car_interface doctor")),
            (not self._centered and after_ns > BACK_WITHIN_NS,
             broken("nobody reports what the servo board holds, and the node isn't back",
                    "let the guard run: guard in pca9685.yaml; start the node again by its launch file")),
            (after_ns > BACK_WITHIN_NS,
             broken("centered, but the node isn't back", "start it again by its launch file, which restarts it")))

    def _is_centered(self, now_ns):
        duty = self.car.held_duty(self._channel, now_ns)
        return duty is not None and (not duty or abs(duty - self.setup.steering.servo_center) <= SAME_DUTY)

    def answer(self, key, now_ns):
        outcome = first(
            (key == "y", fine(f"{self._centered}, and the node came back")),
            (key == "n", broken("the board reports the center, and the wheels weren't there at once",
                                "look at the servo's plug and power; center the steering first; let the guard run: "
                                "guard in pca9685.yaml")),
            (self.car.by_program(now_ns), NOT_HELD),
            (self._is_centered(now_ns), "the wheels must be turned first"))
        if outcome is not None:
            return outcome
        self._killed_ns, self._node, self.steering = now_ns, self.car.sender, None
        trouble = self.car.kill(self._node)
        if trouble:
            return skipped(f"it couldn't be killed: {trouble}")
        self.go_on("It was killed: wait.", "", "")
        return None


class _ByStick(Question):
    """The person drives by the manual deadman and the right stick."""

    _stick = 0.0  # the farthest that was seen
    _was_given = False  # the ESC got something else than neutral

    def missing(self, now_ns):
        return ("" if self.setup.throttle and not self.car.throttle.is_stale(now_ns)
                else "throttle_arb isn't heard: launch with throttle:=true")

    def seen(self, now_ns):
        trouble = self.car.by_hand(now_ns)
        if trouble:
            return trouble
        speed = "" if self.car.speed.is_stale(now_ns) else f", the wheels' sensors say {self.car.speed.value:+.1f} m/s"
        return f"the ESC gets {self.car.throttle.value.granted:+.2f} of the throttle{speed}"

    def step(self, now_ns):
        if self.car.by_hand(now_ns):
            return
        stick = self.car.throttle_stick.fresh(now_ns) or 0.0
        if abs(stick) > abs(self._stick):
            self._stick = stick
        self._was_given = self._was_given or self.car.throttle.value.granted != 0.0
        self._look(stick, now_ns)

    def _look(self, stick, now_ns):
        """Look at the stick, while it reaches the ESC."""


class NeutralDuty(_ByStick):
    """Whether the wheels stand at the ESC's neutral, and at which one they do."""

    title = "the ESC's neutral"
    ask = ("{manual}, and touch no stick. Do all wheels stand still? If they creep, shift the neutral with + and - "
           "until they stand, and a little further.")
    help, keys = "Y they stand   + or - shift the neutral   N they don't stop", f"+-y{ENTER}n"

    def seen(self, now_ns):
        turned = sum(map(abs, self.car.pulses))
        return (f"{super().seen(now_ns)}; the neutral is {self.car.neutral}"
                + (f"; the sensors counted {turned} pulses" if turned else ""))

    def answer(self, key, now_ns):
        trouble, usual, neutral = self.car.by_hand(now_ns), self.setup.throttle.neutral, self.car.neutral
        if key in "+-":
            if not trouble:
                more = NEUTRAL_STEP if key == "+" else -NEUTRAL_STEP
                self.car.neutral = max(usual - MAX_NEUTRAL, min(usual + MAX_NEUTRAL, neutral + more))
            return None
        text = f"the wheels stand at duty {neutral}"
        return first(
            (key == "n", broken(
                f"the wheels don't stop, at duty {neutral} either",
                "teach the ESC its neutral, by its own manual, while throttle_arb runs and nobody drives")),
            (trouble, "hold the deadman while you answer"),
            (self.car.throttle.value.granted, "let go of the stick"),
            (neutral == usual, fine(text)),
            (True, learned(text, changes={THROTTLE: {"neutral": neutral}})))


class ThrottleDirection(_ByStick):
    """The stick, the ESC and the motor, each forward."""

    title = "the throttle's direction"
    ask = "{manual}. PUSH the right stick forward, slowly, until the wheels just turn. Which way do they turn?"
    help, keys = "F forward   B backward   N they don't turn", "fbn"
    _was_pulled = False  # since that was asked for

    def _look(self, stick, now_ns):
        self._was_pulled = self._was_pulled or self.keys == YES_NO and stick <= -PUSHED

    def answer(self, key, now_ns):
        if self.keys == YES_NO:
            return first(
                (not self._was_pulled, "pull the stick first, with the deadman held"),
                (key == "y", learned("this ESC drives forward on the pulses behind neutral",
                                     changes={THROTTLE: {"exchanged": True}})),
                (True, broken("the motor turns the other way round", "exchange two wires between ESC and motor")))
        pushed, given = self._stick > 0, self._was_given
        outcome = first(
            (abs(self._stick) < PUSHED, "push the stick first, with the deadman held"),
            (key == "f" and pushed, fine("pushed, the wheels turn forward")),
            (key == "f", self._inverted("stick and ESC both went the other way",
                                        "launch again, and check the direction again, now with the right stick")),
            (key == "n" and not pushed and not given,
             self._inverted("the stick went the other way, and was taken for a brake")),
            (key == "n", broken(
                f"the wheels don't turn; {'the ESC got throttle' if given else 'the ESC got neutral: push further'}",
                f"look at the ESC: switched on? plug in channel {self.setup.throttle.channel}? its own neutral "
                "learned, armed? then the motor's wires")),
            (not pushed, self._inverted("the stick went the other way")),
            (not self.setup.calibrates_esc, broken(
                "pushed, the wheels turn backward",
                "exchange two wires between ESC and motor; or launch with calibration_drive:=true and check again: "
                "that shows whether duty_table in throttle.yaml is to fall instead")))
        if outcome is None:
            self.go_on("Let go of the stick. Now PULL it back gently, and hold it. Do the wheels turn FORWARD, at "
                       "once?", "Y yes   N no, they stop or stand")
        return outcome

    def _inverted(self, answer, repair=""):
        return learned(answer, repair, {GAMEPAD: {"throttle_scale": -self.setup.throttle_scale}})


class EscKind(_ByStick):
    """What a pull does, by a person's eyes."""

    title = "the ESC's kind"
    ask = ("{manual}. Push until the wheels turn, let the stick go, and at once PULL it and hold it for two seconds. "
           "What do the wheels do?")
    help = "1 stop and stay   2 stop, then turn backward   3 turn backward at once   N other"
    keys = "123n"
    _was_pushed = _has_pulled = False
    _was_centered = True  # since the pull before
    _pulled_since_ns: int | None = None

    def missing(self, now_ns):
        if not self.car.drives_forward:
            return "a push has to drive forward first: launch again, or repair it, and check again"
        return super().missing(now_ns) or ("" if self.setup.calibrates_esc else
                                           "the car was launched without calibration_drive:=true")

    def _look(self, stick, now_ns):
        self._was_pushed = self._was_pushed or stick >= PUSHED and self._was_given
        self._was_centered = self._was_centered or abs(stick) < PUSHED
        if stick <= -PUSHED and self._was_pushed and self._was_centered:
            self._pulled_since_ns = self._pulled_since_ns or now_ns
            self._has_pulled = self._has_pulled or now_ns - self._pulled_since_ns >= PULL_NS
        else:
            self._pulled_since_ns = None

    def answer(self, key, now_ns):
        if key == "1" and self._has_pulled:
            self._was_centered = self._has_pulled = False
            self.go_on("Let go of the stick, pull it once more, and hold it for two seconds. Do the wheels turn "
                       "BACKWARD?")
            return None
        kind = {"2": BRAKE_BECOMES_REVERSE, "3": DIRECT_REVERSE, "y": BRAKE_THEN_REVERSE, "n": FORWARD_ONLY}.get(key)
        return first(
            (key == "n" and self.keys != YES_NO,
             broken("its kind isn't clear", "find it by a drive and calibrate_esc: docs/calibrate.md, 3")),
            (not self._has_pulled, "first do it, a second of the pull at least"),
            (kind == self.setup.profile, fine(f"{kind}, as the file has it")),
            (True, learned(kind, "have calibrate_esc measure it: until then a stop brakes only once the ESC has proved "
                           "its kind", {THROTTLE: {"esc/profile": kind}})))


class LettingGo(_ByStick):
    """The deadman is released while the wheels turn."""

    title = "letting go"
    ask = "{manual}, push until the wheels turn, and then let go of the deadman ONLY: keep the stick where it is."
    help, keys = "N they go on though I let go", "n"
    _released_ns: int | None = None
    _took_s = 0.0  # until the ESC got neutral or its brake

    def step(self, now_ns):
        super().step(now_ns)
        if self._took_s or not self._was_given:
            return None
        if self.car.held_mode(now_ns) is not None:
            self._released_ns = None
            return None
        self._released_ns = self._released_ns or now_ns
        duty = self.car.held_duty(self.setup.throttle.channel, now_ns)
        if duty is not None and (abs(duty - self.car.neutral) <= SAME_DUTY or self._brakes(duty)):
            self._took_s = math.ceil((now_ns - self._released_ns) / NS_PER_S * 10 + 0.1) / 10  # it is looked at 20 Hz
            self.go_on(f"The ESC got neutral or its brake within {self._took_s:.1f} s of the release. Do the wheels "
                       "run out, and stand?")
        elif now_ns - self._released_ns > NEUTRAL_WITHIN_NS:
            return broken("the ESC's channel is neither neutral nor its brake half a second after the release",
                          "don't drive it: rosrun car_interface doctor")
        return None

    def _brakes(self, duty):
        """Return whether a duty is the brake of a stop, which an ESC of a known kind gets."""
        table = self.setup.throttle.duty_table
        return self.car.throttle.value.esc in STOPS and (duty - self.car.neutral) * (table[-1] - table[0]) < 0

    def answer(self, key, now_ns):
        return first(
            (key == "y", fine(f"neutral or its brake within {self._took_s:.1f} s, and the wheels stood")),
            (self._was_given,
             broken("the wheels go on after the release", "don't drive it: disconnect the battery. The ESC has another "
                                                          "neutral, or sits on another channel")))
