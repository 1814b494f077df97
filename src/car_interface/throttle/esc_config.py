"""What is known of a car's speed controller (ESC), and the rules for driving it. Named as the ROS parameters ``esc/…``.

A request, a pulse that the servo board holds and a dead band are fractions: 0 is neutral, 1 full forward, −1 full brake
or reverse, linear in the duty between neutral and each end.
"""
from __future__ import annotations

from dataclasses import dataclass, fields

from car_interface.common.errors import ConfigError

BRAKE_THEN_REVERSE = "brake_then_reverse"
BRAKE_BECOMES_REVERSE = "brake_becomes_reverse"
DIRECT_REVERSE = "direct_reverse"
FORWARD_ONLY = "forward_only"
UNVERIFIED = "unverified"
PROFILES = (BRAKE_THEN_REVERSE, BRAKE_BECOMES_REVERSE, DIRECT_REVERSE, FORWARD_ONLY, UNVERIFIED)

NAMESPACE = "esc/"
FLAGS = ("profile_measured", "calibration_drive")
# ROS parameter and accepted range of each number.
NUMBERS = {
    "arming_time_s": ("arming_time", 0.1, 10.0),
    "dwell_s": ("dwell", 0.1, 0.5),
    "dead_band_forward": ("dead_band_forward", 0.02, 0.3),
    "dead_band_reverse": ("dead_band_reverse", 0.02, 0.3),
    "reverse_after_neutral_s": ("reverse_after_neutral", 0.0, 60.0),
    "stop_brake": ("stop_brake", 0.0, 1.0),
    "stop_brake_time_s": ("stop_brake_time", 0.1, 10.0),
    "brake_deceleration_mps2": ("brake_deceleration", 0.5, 15.0),
    "drag_deceleration_mps2": ("drag_deceleration", 0.05, 5.0),
    "brake_margin_mps": ("brake_margin", 0.3, 3.0),
    "speed_timeout_s": ("speed_timeout", 0.05, 0.5),
    "motion_speed_mps": ("motion_speed", 0.1, 1.0),
    "motion_time_s": ("motion_time", 0.05, 0.3),
}


@dataclass(frozen=True)
class EscConfig:
    """One ESC.

    Attributes:
        profile: how it takes a pulse behind neutral.
            ``brake_then_reverse``: after forward it brakes, however long; reverse takes neutral and a second pull
            (Traxxas XL-5 and VXL in Sport, most hobby ESCs).
            ``brake_becomes_reverse``: it brakes, and a brake that is held at standstill drives backward (crawlers).
            ``direct_reverse``: it drives backward at once.
            ``forward_only``: it brakes (Traxxas in Race).
            ``unverified``, the default: nobody has said. Then no stop brakes, and no pulse is sent that any of these
            could take amiss.
        profile_measured: calibrate_esc saw it. Then a stop brakes without odometry, too, where the profile is sure to
            brake. Otherwise this waits until the car was once seen to stand still under a held brake.
        calibration_drive: a person's stick goes to the ESC as it is, with one scale and without a dead band, so that
            calibrate_esc sees what the ESC makes of it: a brake may become reverse. No stop brakes meanwhile; e-stop,
            deadman, arming and the motion check hold, and a planner's requests keep to the rules.
        arming_time_s: how long neutral is held before anything else. ESCs find their neutral within a second of
            power-up; BARC's cars wait as long.
        dwell_s: neutral of this length lets an ESC change to reverse. Nobody publishes it: BARC found 0.125 s to be the
            least, ArduPilot's author 0.3 s. The default is longer than any known; it costs half a second at a reverse.
        dead_band_forward, dead_band_reverse: smaller requests are given as neutral. It must not be less than the ESC's
            own. BARC's XL-5 takes 1451 to 1513 µs for neutral: ±0.07, and a little.
        reverse_after_neutral_s: so long in neutral after driving forward, and the ESC takes the first pull for reverse;
            0 = it never does, as Traxxas' and Tamiya's. Cheap ones, and HPI's SC-15WP, do after some seconds.
        stop_brake: the brake of a stop, 0 = coast. Half: the whole brake locks the wheels of a Slash on smooth floors,
            and a car with locked wheels does not steer.
        stop_brake_time_s: a stop brakes no longer than this: 10 m/s ÷ (0.5 × 7 m/s²) = 2.9 s.
        brake_deceleration_mps2: what the full brake guarantees. A Slash reaches about 7 on asphalt; 3 is left on dust.
        drag_deceleration_mps2: what is left in neutral at low speed: 0.3 to 0.4 for a Slash on a hard floor.
        brake_margin_mps: where the ESC may take a brake for reverse, the car is braked only above this speed, and above
            what its speed's age and the board's 80 ms cost, and coasts below.
        speed_timeout_s: an older speed is unknown.
        motion_speed_mps, motion_time_s: motion against the state beyond both puts the ESC to neutral. A wheel that is
            pushed over a sensor by hand, or settles after a stop, stays below.

    Raises:
        ConfigError: naming the ROS parameter.
    """

    profile: str = UNVERIFIED
    profile_measured: bool = False
    calibration_drive: bool = False
    arming_time_s: float = 1.0
    dwell_s: float = 0.5
    dead_band_forward: float = 0.08
    dead_band_reverse: float = 0.08
    reverse_after_neutral_s: float = 0.0
    stop_brake: float = 0.5
    stop_brake_time_s: float = 3.0
    brake_deceleration_mps2: float = 3.0
    drag_deceleration_mps2: float = 0.3
    brake_margin_mps: float = 0.5
    speed_timeout_s: float = 0.5
    motion_speed_mps: float = 0.2
    motion_time_s: float = 0.2

    def __post_init__(self):
        if self.profile not in PROFILES:
            raise ConfigError(NAMESPACE + "profile", self.profile, "one of " + ", ".join(PROFILES))
        for field in FLAGS:
            if not isinstance(getattr(self, field), bool):
                raise ConfigError(NAMESPACE + field, getattr(self, field), "true or false")
        if self.profile_measured and self.profile == UNVERIFIED:
            raise ConfigError(NAMESPACE + "profile_measured", True, "false, while esc/profile is unverified")
        if self.calibration_drive and self.profile != UNVERIFIED:
            raise ConfigError(NAMESPACE + "calibration_drive", True, f"false, or esc/profile {UNVERIFIED}")
        for field, (name, low, high) in NUMBERS.items():
            value = getattr(self, field)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
                raise ConfigError(NAMESPACE + name, value, f"a number from {low} to {high}")
        if 0 < self.stop_brake < self.dead_band_reverse:
            raise ConfigError(NAMESPACE + "stop_brake", self.stop_brake,
                              f"0 (a stop coasts), or at least esc/dead_band_reverse {self.dead_band_reverse}")
        if 0 < self.reverse_after_neutral_s < self.dwell_s:
            raise ConfigError(NAMESPACE + "reverse_after_neutral", self.reverse_after_neutral_s,
                              f"0 (never), or at least esc/dwell {self.dwell_s}")

    @property
    def board_holds_pulls(self) -> bool:
        """Whether the servo board holds a brake for as long as other pulses, since a gap would let it reverse."""
        return self.profile == BRAKE_THEN_REVERSE and self.profile_measured


def read_esc(params) -> EscConfig:
    """The configuration from the parameters ``esc/…``.

    Raises:
        ConfigError: naming the parameter.
    """
    defaults = {field.name: field.default for field in fields(EscConfig)}
    numbers = {field: params.number(NAMESPACE + name, defaults[field], low, high)
               for field, (name, low, high) in NUMBERS.items()}
    flags = {field: params.flag(NAMESPACE + field, False) for field in FLAGS}
    return EscConfig(profile=params.choice(NAMESPACE + "profile", UNVERIFIED, PROFILES), **flags, **numbers)
