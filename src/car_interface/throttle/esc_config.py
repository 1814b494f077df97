"""Configure one speed controller (ESC) and the rules for driving it: the ROS parameters ``esc/…``.

A request, a pulse that the servo board holds and a dead band are fractions: 0 is neutral, 1 full forward, −1 full brake
or reverse, linear in the duty between neutral and each end.
"""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common import declared
from car_interface.common.errors import require

BRAKE_THEN_REVERSE = "brake_then_reverse"
BRAKE_BECOMES_REVERSE = "brake_becomes_reverse"
DIRECT_REVERSE = "direct_reverse"
FORWARD_ONLY = "forward_only"
UNVERIFIED = "unverified"
PROFILES = (BRAKE_THEN_REVERSE, BRAKE_BECOMES_REVERSE, DIRECT_REVERSE, FORWARD_ONLY, UNVERIFIED)


@dataclass(frozen=True)
class EscConfig:
    """Configure one ESC; the sources of the defaults are beside them.

    ``profile`` says how the ESC takes a pulse behind neutral:
        ``brake_then_reverse``: after forward it brakes, however long; reverse takes neutral and a second pull (Traxxas
        XL-5 and VXL in Sport, most hobby ESCs).
        ``brake_becomes_reverse``: it brakes, and a brake that is held at standstill drives backward (crawlers).
        ``direct_reverse``: it drives backward at once.
        ``forward_only``: it brakes (Traxxas in Race).
        ``unverified``: unknown. No stop brakes, and a brake is given only where each of the others slows the car.
    Without ``profile_measured``, a stop trusts the kind only after the ESC has proved it (``esc_proof``). A
    ``calibration_drive`` gives a person's stick to the ESC with one scale and without a dead band, so that
    calibrate_esc sees how the ESC answers: a brake may become reverse, and no stop brakes. E-stop, deadman, arming and
    the motion check stay in force, and a planner's requests keep to the rules.

    Raises:
        ConfigError: naming the parameter.
    """

    profile: str = declared.choice(
        "esc/profile", UNVERIFIED, "the kind of ESC: see [Throttle](throttle.md)", choices=PROFILES)
    profile_measured: bool = declared.flag(
        "esc/profile_measured", False, "true = calibrate_esc saw it: a stop brakes from the start on")
    calibration_drive: bool = declared.flag(
        "esc/calibration_drive", False, "true = the ESC gets a person's stick as it is, for "
                                        "[calibrate_esc](calibrate.md#3-the-esc); only with an unverified one")
    # ESCs find their neutral within a second of power-up; BARC's cars wait for that time, too.
    arming_time_s: float = declared.number(
        "esc/arming_time", 1.0, "neutral before anything else, after a start and after the board gave no pulse", "s",
        low=0.1, high=10.0)
    # No maker publishes it. BARC found 0.125 s to be the minimum, ArduPilot's author 0.3 s. The default is longer than
    # any known; it costs half a second at each change to reverse.
    dwell_s: float = declared.number(
        "esc/dwell", 0.5, "neutral of this length lets the ESC change to reverse", "s", low=0.1, high=0.5)
    # Not less than the ESC's own dead band. BARC's XL-5 takes 1451 to 1513 µs for neutral, which is ±0.07.
    dead_band_forward: float = declared.number(
        "esc/dead_band_forward", 0.08, "smaller requests are given as neutral, or [in pulses](throttle.md#downhill)",
        low=0.02, high=0.3)
    dead_band_reverse: float = declared.number(
        "esc/dead_band_reverse", 0.08, "smaller requests are given as neutral, or [in pulses](throttle.md#downhill)",
        low=0.02, high=0.3)
    # Traxxas' and Tamiya's ESCs never forget. Cheap ones, and HPI's SC-15WP, do after some seconds.
    reverse_after_neutral_s: float = declared.number(
        "esc/reverse_after_neutral", 0.0, "so long in neutral after driving, and the ESC takes the first pull for "
                                          "reverse; 0 = never", "s", low=0.0, high=60.0)
    # The full brake locks the wheels of a Slash on smooth floors, and a car with locked wheels doesn't steer.
    stop_brake: float = declared.number("esc/stop_brake", 0.5, "the brake of a stop; 0 = coast", low=0.0, high=1.0)
    # From 10 m/s with the default brake on asphalt: 10 / (0.5 × 7 m/s²) = 2.9 s.
    stop_brake_time_s: float = declared.number(
        "esc/stop_brake_time", 3.0, "a stop brakes no longer than this", "s", low=0.1, high=10.0)
    # A Slash reaches about 7 m/s² on asphalt, and 3 m/s² on dust.
    brake_deceleration_mps2: float = declared.number(
        "esc/brake_deceleration", 3.0, "what the full brake guarantees", "m/s²", low=0.5, high=15.0)
    # A Slash on a hard floor has 0.3 to 0.4 m/s².
    drag_deceleration_mps2: float = declared.number(
        "esc/drag_deceleration", 0.3, "what neutral guarantees at low speed", "m/s²", low=0.05, high=5.0)
    # In addition the car must be fast enough to roll until the pull ends (``MeasuredMotion.outlasts_a_pull``).
    brake_margin_mps: float = declared.number(
        "esc/brake_margin", 0.5, "where an ESC may take a brake for reverse, it is braked only above this speed", "m/s",
        low=0.3, high=3.0)
    speed_timeout_s: float = declared.number(
        "esc/speed_timeout", 0.5, "an older speed is unknown", "s", low=0.05, high=0.5)
    # A wheel that is turned by hand from one sensor pulse to the next, or settles after a stop, stays below both.
    motion_speed_mps: float = declared.number(
        "esc/motion_speed", 0.2, "motion against the ESC's state that is faster, for longer than `esc/motion_time`, "
                                 "puts it to neutral", "m/s", low=0.1, high=1.0)
    motion_time_s: float = declared.number("esc/motion_time", 0.2, "see `esc/motion_speed`", "s", low=0.05, high=0.3)

    def __post_init__(self):
        declared.check(self)
        is_unverified = self.profile == UNVERIFIED
        require(not (self.profile_measured and is_unverified), "esc/profile_measured", True,
                "false, while esc/profile is unverified")
        require(is_unverified or not self.calibration_drive, "esc/calibration_drive", True,
                f"false, or esc/profile {UNVERIFIED}")
        require(not 0 < self.stop_brake < self.dead_band_reverse, "esc/stop_brake", self.stop_brake,
                f"0 (a stop coasts), or at least esc/dead_band_reverse {self.dead_band_reverse}")
        require(not 0 < self.reverse_after_neutral_s < self.dwell_s, "esc/reverse_after_neutral",
                self.reverse_after_neutral_s, f"0 (never), or at least esc/dwell {self.dwell_s}")
