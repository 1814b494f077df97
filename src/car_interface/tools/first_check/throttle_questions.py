"""The questions on throttle and ESC, in which the person drives by the manual deadman and the right stick."""
from __future__ import annotations

import math
from functools import partial

from car_interface.common.causes import MANUAL
from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc import BRAKING, HOLD
from car_interface.throttle.esc_config import (
    BRAKE_BECOMES_REVERSE,
    BRAKE_THEN_REVERSE,
    DIRECT_REVERSE,
    FORWARD_ONLY,
)
from car_interface.tools.first_check.question import (
    ENTER,
    GAMEPAD,
    LEARNED,
    SAME_DUTY,
    THROTTLE,
    Question,
    Result,
)

PUSHED = 0.1  # of a stick: moved on purpose
NEUTRAL_STEP, MAX_NEUTRAL = 5, 100  # duty; the second is throttle_arb's live_range
PULL_NS = NS_PER_S  # of a pull, to see what the wheels do
NEUTRAL_WITHIN_NS = NS_PER_S // 2
STOPS = (BRAKING, HOLD)


class _ByStick(Question):
    """The person drives by the manual deadman and the right stick."""

    def __init__(self, car):
        super().__init__(car)
        self._stick = 0.0  # the farthest that was seen
        self._was_given = False  # the ESC got something else than neutral

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

    def _has_pushed(self):
        self.note = "" if abs(self._stick) >= PUSHED else "push the stick first, with the deadman held"
        return not self.note


class NeutralDuty(_ByStick):
    """Whether the wheels stand at the ESC's neutral, and at which one they do."""

    title = "the ESC's neutral"
    help = "Y they stand   + or - shift the neutral   N they don't stop"

    def __init__(self, car):
        super().__init__(car)
        self._shift = 0
        self._pulses = sum(map(abs, car.pulses))
        self.keys = {"+": partial(self._move, NEUTRAL_STEP), "-": partial(self._move, -NEUTRAL_STEP),
                     "y": self._stand, ENTER: self._stand, "n": self._no}

    @property
    def text(self):
        return (f"{self._hold(MANUAL)}, and touch no stick. Do all wheels stand still? If they creep, shift the "
                "neutral with + and - until they stand, and a little further.")

    def seen(self, now_ns):
        turned = sum(map(abs, self.car.pulses)) - self._pulses
        return (f"{super().seen(now_ns)}; the neutral is {self._duty()}"
                + (f"; the sensors counted {turned} pulses" if turned else ""))

    def _duty(self):
        return self.setup.throttle.neutral + self._shift

    def _move(self, more, now_ns):
        if not self.car.by_hand(now_ns):
            self._shift = max(-MAX_NEUTRAL, min(MAX_NEUTRAL, self._shift + more))
            self.neutral = self._duty()

    def _stand(self, now_ns):
        if self.car.by_hand(now_ns):
            self.note = "hold the deadman while you answer"
        elif self.car.throttle.value.granted:
            self.note = "let go of the stick"
        elif self._shift:
            self._learned(f"the wheels stand at duty {self._duty()}", THROTTLE, neutral=self._duty())
        else:
            self._fine(f"the wheels stand at duty {self._duty()}")

    def _no(self, now_ns):
        self._broken(f"the wheels don't stop, at duty {self._duty()} either",
                     "teach the ESC its neutral, by its own manual, while throttle_arb runs and nobody drives")


class ThrottleDirection(_ByStick):
    """The stick, the ESC and the motor, each forward."""

    title = "the throttle's direction"

    def __init__(self, car):
        super().__init__(car)
        self._asks_pull = self._was_pulled = False
        self.keys = {"f": self._forward, "b": self._backward, "n": self._nothing, "y": partial(self._pulled, True)}

    @property
    def text(self):
        if self._asks_pull:
            return "Let go of the stick. Now PULL it back gently, and hold it. Do the wheels turn FORWARD, at once?"
        return (f"{self._hold(MANUAL)}. PUSH the right stick forward, slowly, until the wheels just turn. Which "
                "way do they turn?")

    @property
    def help(self):
        if self._asks_pull:
            return "Y yes   N no, they stop or stand"
        return "F forward   B backward   N they don't turn"

    def _look(self, stick, now_ns):
        self._was_pulled = self._was_pulled or self._asks_pull and stick <= -PUSHED

    def _forward(self, now_ns):
        if self._asks_pull or not self._has_pushed():
            return
        if self._stick > 0:
            self._fine("pushed, the wheels turn forward")
        else:
            self.result = Result(LEARNED, "stick and ESC both went the other way", {GAMEPAD: self._inverted},
                                 "launch again, and check the direction again, now with the right stick")

    def _backward(self, now_ns):
        if self._asks_pull or not self._has_pushed():
            return
        if self._stick < 0:
            self._learned("the stick went the other way", GAMEPAD, **self._inverted)
        elif self.setup.calibrates_esc:
            self._asks_pull = True
        else:
            self._broken("pushed, the wheels turn backward",
                         "exchange two wires between ESC and motor; or launch with calibration_drive:=true and check "
                         "again: that shows whether duty_table in throttle.yaml is to fall instead")

    def _nothing(self, now_ns):
        if self._asks_pull:
            self._pulled(False, now_ns)
        elif not self._has_pushed():
            return
        elif self._stick < 0 and not self._was_given:
            self._learned("the stick went the other way, and was taken for a brake", GAMEPAD, **self._inverted)
        else:
            given = "the ESC got throttle" if self._was_given else "the ESC got neutral: push further"
            self._broken(f"the wheels don't turn; {given}",
                         f"look at the ESC: switched on? plug in channel {self.setup.throttle.channel}? its own "
                         "neutral learned, armed? then the motor's wires")

    def _pulled(self, turns_forward, now_ns):
        if not self._asks_pull:
            return
        if not self._was_pulled:
            self.note = "pull the stick first, with the deadman held"
        elif turns_forward:
            self._learned("this ESC drives forward on the pulses behind neutral", THROTTLE, exchanged=True)
        else:
            self._broken("the motor turns the other way round", "exchange two wires between ESC and motor")

    @property
    def _inverted(self):
        return {"throttle_scale": -self.setup.throttle_scale}


class EscKind(_ByStick):
    """What a pull does, by a person's eyes.

    Args:
        is_forward: a push drives forward, as far as that is known.
    """

    title = "the ESC's kind"

    def __init__(self, car, is_forward: bool = True):
        super().__init__(car)
        self._is_forward = is_forward
        self._was_pushed = self._asks_second = False
        self._was_centered = True  # since the pull before
        self._pulled_since_ns: int | None = None
        self._has_pulled = False
        self.keys = {"1": self._braked, "2": partial(self._saw, BRAKE_BECOMES_REVERSE),
                     "3": partial(self._saw, DIRECT_REVERSE), "y": partial(self._reversed, BRAKE_THEN_REVERSE),
                     "n": self._no}

    def missing(self, now_ns):
        if not self._is_forward:
            return "a push has to drive forward first: launch again, or repair it, and check again"
        return super().missing(now_ns) or ("" if self.setup.calibrates_esc else
                                           "the car was launched without calibration_drive:=true")

    @property
    def text(self):
        if self._asks_second:
            return "Let go of the stick, pull it once more, and hold it for two seconds. Do the wheels turn BACKWARD?"
        return (f"{self._hold(MANUAL)}. Push until the wheels turn, let the stick go, and at once PULL it and hold "
                "it for two seconds. What do the wheels do?")

    @property
    def help(self):
        if self._asks_second:
            return "Y yes   N no"
        return "1 stop and stay   2 stop, then turn backward   3 turn backward at once   N other"

    def _look(self, stick, now_ns):
        self._was_pushed = self._was_pushed or stick >= PUSHED and self._was_given
        self._was_centered = self._was_centered or abs(stick) < PUSHED
        if stick <= -PUSHED and self._was_pushed and self._was_centered:
            self._pulled_since_ns = self._pulled_since_ns or now_ns
            self._has_pulled = self._has_pulled or now_ns - self._pulled_since_ns >= PULL_NS
        else:
            self._pulled_since_ns = None

    def _is_ready(self):
        self.note = "" if self._has_pulled else "first do it, a second of the pull at least"
        return not self.note

    def _braked(self, now_ns):
        if not self._asks_second and self._is_ready():
            self._asks_second, self._was_centered, self._has_pulled = True, False, False

    def _saw(self, kind, now_ns):
        if not self._asks_second and self._is_ready():
            self._conclude(kind)

    def _reversed(self, kind, now_ns):
        if self._asks_second and self._is_ready():
            self._conclude(kind)

    def _no(self, now_ns):
        if self._asks_second:
            self._reversed(FORWARD_ONLY, now_ns)
        else:
            self._broken("its kind isn't clear", "find it by a drive and calibrate_esc: docs/calibrate.md, 3")

    def _conclude(self, kind):
        if kind == self.setup.profile:
            self._fine(f"{kind}, as the file has it")
        else:
            self.result = Result(LEARNED, kind, {THROTTLE: {"esc/profile": kind}},
                                 "have calibrate_esc measure it: until then a stop brakes only once the ESC has proved "
                                 "its kind")


class LettingGo(_ByStick):
    """The deadman is released while the wheels turn."""

    title = "letting go"

    def __init__(self, car):
        super().__init__(car)
        self._released_ns: int | None = None
        self._took_s: float | None = None
        self.keys = {"y": partial(self._ran_out, True), "n": partial(self._ran_out, False)}

    @property
    def text(self):
        if self._took_s is None:
            return (f"{self._hold(MANUAL)}, push until the wheels turn, and then let go of the deadman ONLY: keep "
                    "the stick where it is.")
        return (f"The ESC got neutral or its brake within {self._took_s:.1f} s of the release. Do the wheels run out, "
                "and stand?")

    @property
    def help(self):
        return "Y yes   N no" if self._took_s is not None else "N they go on though I let go"

    def step(self, now_ns):
        super().step(now_ns)
        if self._took_s is not None or not self._was_given:
            return
        is_held = self.car.held_mode(now_ns) is not None
        if is_held:
            self._released_ns = None
            return
        self._released_ns = self._released_ns or now_ns
        duty = self.car.held_duty(self.setup.throttle.channel, now_ns)
        if duty is not None and (abs(duty - self.car.neutral) <= SAME_DUTY or self._brakes(duty)):
            self._took_s = math.ceil((now_ns - self._released_ns) / NS_PER_S * 10 + 0.1) / 10  # it is looked at 20 Hz
        elif now_ns - self._released_ns > NEUTRAL_WITHIN_NS:
            self._broken("the ESC's channel is neither neutral nor its brake half a second after the release",
                         "don't drive it: rosrun car_interface doctor")

    def _brakes(self, duty):
        """Return whether a duty is the brake of a stop, which an ESC of a known kind gets."""
        table = self.setup.throttle.duty_table
        return self.car.throttle.value.esc in STOPS and (duty - self.car.neutral) * (table[-1] - table[0]) < 0

    def _ran_out(self, did, now_ns):
        if did and self._took_s is not None:
            self._fine(f"neutral or its brake within {self._took_s:.1f} s, and the wheels stood")
        elif not did and (self._took_s is not None or self._was_given):
            self._broken("the wheels go on after the release", "don't drive it: disconnect the battery. The ESC has "
                                                               "another neutral, or sits on another channel")
