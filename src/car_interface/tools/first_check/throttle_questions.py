"""The questions on throttle and ESC, in which the person drives by the manual deadman and the right stick."""
from __future__ import annotations

import math

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc import BRAKING, HOLD
from car_interface.throttle.esc_config import BRAKE_BECOMES_REVERSE, BRAKE_THEN_REVERSE, DIRECT_REVERSE, FORWARD_ONLY
from car_interface.tools.first_check.car import SAME_DUTY
from car_interface.tools.first_check.question import ENTER, GAMEPAD, THROTTLE, Question, broken, fine, learned

PUSHED = 0.1  # of a stick: moved on purpose
NEUTRAL_STEP, MAX_NEUTRAL = 5, 100  # duty; the second is throttle_arb's live_range
PULL_NS = NS_PER_S  # of a pull, to see what the wheels do
NEUTRAL_WITHIN_NS = NS_PER_S // 2
STOPS = (BRAKING, HOLD)


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
        stick = 0.0 if self.car.throttle_stick.is_stale(now_ns) else self.car.throttle_stick.value
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
    _shift = 0

    def __init__(self, car):
        super().__init__(car)
        self._pulses = sum(map(abs, car.pulses))

    def seen(self, now_ns):
        turned = sum(map(abs, self.car.pulses)) - self._pulses
        return (f"{super().seen(now_ns)}; the neutral is {self._duty()}"
                + (f"; the sensors counted {turned} pulses" if turned else ""))

    def _duty(self):
        return self.setup.throttle.neutral + self._shift

    def answer(self, key, now_ns):
        trouble = self.car.by_hand(now_ns)
        if key == "n":
            return broken(f"the wheels don't stop, at duty {self._duty()} either",
                          "teach the ESC its neutral, by its own manual, while throttle_arb runs and nobody drives")
        if key in "+-":
            if not trouble:
                more = NEUTRAL_STEP if key == "+" else -NEUTRAL_STEP
                self._shift = max(-MAX_NEUTRAL, min(MAX_NEUTRAL, self._shift + more))
                self.neutral = self._duty()
            return None
        if trouble:
            return "hold the deadman while you answer"
        if self.car.throttle.value.granted:
            return "let go of the stick"
        text = f"the wheels stand at duty {self._duty()}"
        return learned(text, {THROTTLE: {"neutral": self._duty()}}) if self._shift else fine(text)


class ThrottleDirection(_ByStick):
    """The stick, the ESC and the motor, each forward."""

    title = "the throttle's direction"
    ask = "{manual}. PUSH the right stick forward, slowly, until the wheels just turn. Which way do they turn?"
    help, keys = "F forward   B backward   N they don't turn", "fbny"
    _asks_pull = _was_pulled = False

    def _look(self, stick, now_ns):
        self._was_pulled = self._was_pulled or self._asks_pull and stick <= -PUSHED

    def answer(self, key, now_ns):
        if key in ("fb" if self._asks_pull else "y"):
            return None
        if self._asks_pull:
            return self._pulled(key == "y")
        if abs(self._stick) < PUSHED:
            return "push the stick first, with the deadman held"
        return {"f": self._forward, "b": self._backward, "n": self._nothing}[key]()

    def _forward(self):
        if self._stick > 0:
            return fine("pushed, the wheels turn forward")
        return self._inverted("stick and ESC both went the other way",
                              "launch again, and check the direction again, now with the right stick")

    def _backward(self):
        if self._stick < 0:
            return self._inverted("the stick went the other way")
        if not self.setup.calibrates_esc:
            return broken("pushed, the wheels turn backward",
                          "exchange two wires between ESC and motor; or launch with calibration_drive:=true and check "
                          "again: that shows whether duty_table in throttle.yaml is to fall instead")
        self._asks_pull, self.help = True, "Y yes   N no, they stop or stand"
        self.ask = "Let go of the stick. Now PULL it back gently, and hold it. Do the wheels turn FORWARD, at once?"
        return None

    def _nothing(self):
        if self._stick < 0 and not self._was_given:
            return self._inverted("the stick went the other way, and was taken for a brake")
        given = "the ESC got throttle" if self._was_given else "the ESC got neutral: push further"
        return broken(f"the wheels don't turn; {given}",
                      f"look at the ESC: switched on? plug in channel {self.setup.throttle.channel}? its own "
                      "neutral learned, armed? then the motor's wires")

    def _pulled(self, turns_forward):
        if not self._was_pulled:
            return "pull the stick first, with the deadman held"
        if turns_forward:
            return learned("this ESC drives forward on the pulses behind neutral", {THROTTLE: {"exchanged": True}})
        return broken("the motor turns the other way round", "exchange two wires between ESC and motor")

    def _inverted(self, answer, repair=""):
        return learned(answer, {GAMEPAD: {"throttle_scale": -self.setup.throttle_scale}}, repair)


class EscKind(_ByStick):
    """What a pull does, by a person's eyes."""

    title = "the ESC's kind"
    ask = ("{manual}. Push until the wheels turn, let the stick go, and at once PULL it and hold it for two seconds. "
           "What do the wheels do?")
    help = "1 stop and stay   2 stop, then turn backward   3 turn backward at once   N other"
    keys = "123yn"
    _was_pushed = _asks_second = _has_pulled = False
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
        if key == "n" and not self._asks_second:
            return broken("its kind isn't clear", "find it by a drive and calibrate_esc: docs/calibrate.md, 3")
        if key in ("123" if self._asks_second else "y"):
            return None
        if not self._has_pulled:
            return "first do it, a second of the pull at least"
        if key == "1":
            self._asks_second, self._was_centered, self._has_pulled = True, False, False
            self.ask = ("Let go of the stick, pull it once more, and hold it for two seconds. Do the wheels turn "
                        "BACKWARD?")
            self.help = "Y yes   N no"
            return None
        kind = {"2": BRAKE_BECOMES_REVERSE, "3": DIRECT_REVERSE, "y": BRAKE_THEN_REVERSE, "n": FORWARD_ONLY}[key]
        if kind == self.setup.profile:
            return fine(f"{kind}, as the file has it")
        return learned(kind, {THROTTLE: {"esc/profile": kind}}, "have calibrate_esc measure it: until then a stop "
                       "brakes only once the ESC has proved its kind")


class LettingGo(_ByStick):
    """The deadman is released while the wheels turn."""

    title = "letting go"
    ask = "{manual}, push until the wheels turn, and then let go of the deadman ONLY: keep the stick where it is."
    help, keys = "N they go on though I let go", "yn"
    _released_ns: int | None = None
    _took_s: float | None = None

    def step(self, now_ns):
        super().step(now_ns)
        if self._took_s is not None or not self._was_given:
            return None
        if self.car.held_mode(now_ns) is not None:
            self._released_ns = None
            return None
        self._released_ns = self._released_ns or now_ns
        duty = self.car.held_duty(self.setup.throttle.channel, now_ns)
        if duty is not None and (abs(duty - self.car.neutral) <= SAME_DUTY or self._brakes(duty)):
            self._took_s = math.ceil((now_ns - self._released_ns) / NS_PER_S * 10 + 0.1) / 10  # it is looked at 20 Hz
            self.ask = (f"The ESC got neutral or its brake within {self._took_s:.1f} s of the release. Do the wheels "
                        "run out, and stand?")
            self.help = "Y yes   N no"
        elif now_ns - self._released_ns > NEUTRAL_WITHIN_NS:
            return broken("the ESC's channel is neither neutral nor its brake half a second after the release",
                          "don't drive it: rosrun car_interface doctor")
        return None

    def _brakes(self, duty):
        """Return whether a duty is the brake of a stop, which an ESC of a known kind gets."""
        table = self.setup.throttle.duty_table
        return self.car.throttle.value.esc in STOPS and (duty - self.car.neutral) * (table[-1] - table[0]) < 0

    def answer(self, key, now_ns):
        if key == "y" and self._took_s is not None:
            return fine(f"neutral or its brake within {self._took_s:.1f} s, and the wheels stood")
        if key == "n" and (self._took_s is not None or self._was_given):
            return broken("the wheels go on after the release", "don't drive it: disconnect the battery. The ESC has "
                                                                "another neutral, or sits on another channel")
        return None
