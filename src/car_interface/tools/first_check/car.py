"""Keeps what is known of a car on a box: its files' values, and the newest messages of its nodes.

Pure: values with their arrival on the monotonic clock.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.sources import PLANNER, TELEOP
from car_interface.common.staleness import TimedInput
from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import PULSES_PER_REVOLUTION, SONARS
from car_interface.steering.calibration import SteeringCalibration
from car_interface.teensy.link.protocol import BACKWARD, FORWARD
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.esc import ARMING

STEERING, THROTTLE, GAMEPAD, HUB = "turn_arb", "throttle", "teleop_logi", "teensy_sensor_hub"  # files
SLOWER = "slower"
SIDES = ("left", "right")  # of the rear wheels
COUNTS = 1 << 32  # OneWheel.dist_abs wraps here
# A Slash reaches 20 m/s; 0.3 of the throttle, the shipped human_scale, is several m/s without a load.
MAX_WHEEL_SPEED_MPS = 3.0
MAX_SCALE = 0.3
SAME_DUTY = 8  # half a count of the servo board
MAX_DRIVE_NS = 8 * NS_PER_S  # at a stretch: a hobby motor without a load heats slowly, and no question needs more
STANDS_MPS = 0.05
# Wheels in the air change no range. The cones look up to 30° sideways, and an echo may jump by some centimeters.
GROUND_M, GROUND_RATIO, GROUND_REPORTS = 0.25, 0.5, 3


@dataclass(frozen=True)
class Setup:
    """What the car was launched with."""

    steering: SteeringCalibration  # turn_arb's
    throttle: ThrottleCalibration | None = None  # throttle_arb's; ``None`` = it doesn't run
    profile: str = ""  # the kind of ESC in the file
    calibrates_esc: bool = False  # throttle_arb gives the ESC each pull, as with calibration_drive:=true
    steer_scale: float = 1.0  # of teleop_logi's axes; negative = inverted
    throttle_scale: float = 1.0
    pulses_per_revolution: int = PULSES_PER_REVOLUTION  # of a rear wheel
    sonars: Sequence[str] = SONARS  # those that the car should have


class Controls(NamedTuple):
    """The gamepad or keyboard that sends."""

    buttons: Mapping[str, int] = {}  # their numbers in its messages, by the deadman's mode
    names: Mapping[str, str] = {}  # what a person knows them by, likewise; SLOWER: of the one that lowers the scale


class Car:
    """The newest of each input, and whether the wheels do what they do in the air.

    Args:
        kill: ends a node's process by its name, and returns why it can't; empty: it did.
    """

    def __init__(self, setup: Setup, kill: Callable[[str], str]):
        self.setup, self.kill = setup, kill
        self.human = TimedInput("human_in_loop", 0.5)
        self.mode = TimedInput("mode", 0.5)
        self.gamepad = TimedInput("teleop_logi's state", 1.0)  # its reason
        self.buttons = TimedInput("joy", 0.5)
        self.controls = Controls()
        self.steering_stick = TimedInput("tele_steer_req", 0.5)
        self.throttle_stick = TimedInput("tele_throt_req", 0.5)
        self.steering = TimedInput("turn_arb's state", 0.5)  # this and the next two: whole messages
        self.throttle = TimedInput("throttle_arb's state", 0.5)
        self.wheels = TimedInput("teensy_wheel", 1.0)
        self.output = TimedInput("/servo/output", 2.5)  # what the servo board holds: on change and once a second
        self.sender = ""  # the node that reports it
        self.speed = TimedInput("odom", 0.5)
        self.link = TimedInput("the Teensy's link", 2.5)
        self.ranges = {name: TimedInput(f"sonar/{name}", 2.0) for name in SONARS}
        # Since the question was asked: all of a sonar's ranges, in m, and the pulses of the left and the right rear
        # wheel, forward ones less backward ones.
        self.reports: dict[str, list[float]] = {name: [] for name in SONARS}
        self.pulses = [0, 0]
        self.neutral = setup.throttle and setup.throttle.neutral  # as tuned by now; ``None`` = no throttle_arb
        # What was learned by now: the request at which the wheels point straight ahead, whether servo_left turns right,
        # and whether a push drives forward.
        self.center, self.is_exchanged, self.drives_forward = 0.0, False, True
        self.drives_since_ns: int | None = None  # since when the ESC gets something else than neutral
        self._distance_m, self._speed_ns = 0.0, 0
        self._starts: dict[str, tuple[float, float]] = {}  # range and distance when the wheels began to turn
        self._follows = dict.fromkeys(SONARS, 0)  # reports in a row that changed as on the ground

    def update_wheels(self, message: Any, now_ns: int) -> None:
        """Take the counts of both wheels."""
        before = self.wheels.value
        self.wheels.update(message, now_ns)
        for side, name in enumerate(SIDES):
            wheel = getattr(message, name)
            more = (wheel.dist_abs - getattr(before, name).dist_abs) % COUNTS if before else 0
            if more < COUNTS // 2:  # else the Teensy has started anew
                self.pulses[side] += {FORWARD: more, BACKWARD: -more}.get(wheel.direction, 0)

    def update_speed(self, speed_mps: float, now_ns: int) -> None:
        """Take the speed by odometry, forward positive."""
        if self.speed.was_received:
            self._distance_m += speed_mps * min(now_ns - self._speed_ns, NS_PER_S // 2) / NS_PER_S
        self._speed_ns = now_ns
        self.speed.update(speed_mps, now_ns)
        if abs(speed_mps) < STANDS_MPS:
            self._starts.clear()

    def update_throttle(self, throttle: Any, now_ns: int) -> None:
        """Take throttle_arb's state."""
        self.throttle.update(throttle, now_ns)
        self.drives_since_ns = (self.drives_since_ns or now_ns) if throttle.granted else None

    def update_range(self, name: str, range_m: float, now_ns: int) -> None:
        """Take a sonar's range."""
        self.ranges[name].update(range_m, now_ns)
        self.reports[name].append(range_m)
        if not math.isfinite(range_m) or self.stands(now_ns):
            self._follows[name] = 0
            return
        start_m, began_m = self._starts.setdefault(name, (range_m, self._distance_m))
        driven_m = (self._distance_m - began_m) * (1 if name.startswith("front") else -1)
        nearer_m = start_m - range_m
        fits = abs(driven_m) >= GROUND_M and abs(nearer_m - driven_m) <= GROUND_RATIO * abs(driven_m)
        self._follows[name] = self._follows[name] + 1 if fits else 0

    def stands(self, now_ns: int) -> bool:
        """Return whether the wheels stand, as far as that is known."""
        return abs(self.speed.fresh(now_ns) or 0.0) < STANDS_MPS

    @property
    def ground_reason(self) -> str:
        """Return why the car seems to move on the ground; empty: it doesn't."""
        name = next((name for name, reports in self._follows.items() if reports >= GROUND_REPORTS), "")
        return name and (f"the car seems to move: what the sonar {name} sees comes nearer or goes away as the wheels "
                         "turn. Put it on a box, all wheels in the air")

    def trouble(self, now_ns: int) -> str:
        """Return why the throttle is too much for this check; empty: it isn't."""
        speed_mps = abs(self.speed.fresh(now_ns) or 0.0)
        if speed_mps > MAX_WHEEL_SPEED_MPS:
            return f"too fast: the wheels turn at {speed_mps:.1f} m/s. Let go, and push less"
        if self.drives_since_ns is not None and now_ns - self.drives_since_ns > MAX_DRIVE_NS:
            return "that was long enough: let go of the stick"
        return ""

    def held_mode(self, now_ns: int) -> str | None:
        """Return the mode of the deadman that is held; ``None``: none is held."""
        return (self.mode.value or "") if self.human.fresh(now_ns) else None

    def by_hand(self, now_ns: int) -> str:
        """Return why the person's stick doesn't reach the ESC; empty: it does."""
        if self.held_mode(now_ns) != MANUAL:
            return f"the manual deadman isn't held{in_brackets(self.gamepad.fresh(now_ns))}"
        if self.throttle.is_stale(now_ns):
            return self.throttle.stale_reason(now_ns)
        throttle = self.throttle.value
        if throttle.esc == ARMING:
            return throttle.esc_reason
        if throttle.human_scale > MAX_SCALE + 1e-6:
            return (f"a full stick gives {throttle.human_scale:.1f} of the throttle, too much for this: press the "
                    f"button for less{in_brackets(self.controls.names.get(SLOWER))} until it gives {MAX_SCALE:g}")
        return "" if throttle.source == TELEOP else throttle.reason

    def by_program(self, now_ns: int) -> str:
        """Return why turn_arb doesn't steer as this program asks; empty: it does."""
        if self.held_mode(now_ns) != AUTONOMOUS:
            return f"the autonomous deadman isn't held{in_brackets(self.gamepad.fresh(now_ns))}"
        if self.steering.is_stale(now_ns):
            return self.steering.stale_reason(now_ns)
        return "" if self.steering.value.source == PLANNER else self.steering.value.reason

    def held_duty(self, channel: int, now_ns: int) -> int | None:
        """Return the duty that the servo board holds on a channel; ``None``: it isn't known."""
        return None if self.output.is_stale(now_ns) else self.output.value[channel]


def in_brackets(text: str | None) -> str:
    """Return a text as a remark behind another one; empty: there is none."""
    return f" ({text})" if text else ""
