"""The parameters esc/… that contradict each other, and that a configuration made by hand is checked like any."""
import pytest

from car_interface.common.errors import ConfigError
from car_interface.throttle.esc_config import EscConfig


@pytest.mark.parametrize("changes", [
    {"stop_brake": 0.0}, {"stop_brake": 0.08}, {"reverse_after_neutral_s": 0.0}, {"reverse_after_neutral_s": 0.5}])
def test_what_just_fits_is_accepted(changes):
    EscConfig(**changes)


@pytest.mark.parametrize("changes, text", [
    ({"profile": "xl5"}, "esc/profile is 'xl5'; accepted: one of brake_then_reverse"),
    ({"profile_measured": True}, "esc/profile_measured is True; accepted: false, while esc/profile is unverified"),
    ({"calibration_drive": True, "profile": "forward_only"},
     "esc/calibration_drive is True; accepted: false, or esc/profile unverified"),
    ({"stop_brake": 0.05},
     "esc/stop_brake is 0.05; accepted: 0 .a stop coasts., or at least esc/dead_band_reverse 0.08"),
    ({"reverse_after_neutral_s": 0.3}, "esc/reverse_after_neutral is 0.3; accepted: 0 .never., or at least esc/dwell"),
])
def test_contradiction_is_refused(changes, text):
    with pytest.raises(ConfigError, match=text):
        EscConfig(**changes)
