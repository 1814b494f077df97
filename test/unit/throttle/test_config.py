"""A file for throttle_arb, read as the node reads its parameters."""

from pathlib import Path

import pytest

from car_interface.common.errors import ConfigError
from car_interface.throttle.config import load_throttle

SHIPPED = Path(__file__).resolve().parents[3] / "config" / "throttle.yaml"


def test_shipped_file_is_that_of_an_unverified_esc():
    config = load_throttle(str(SHIPPED))
    esc = config.esc
    assert (esc.profile, esc.profile_measured, esc.calibration_drive) == ("unverified", False, False)
    assert (config.calibration.channel, config.calibration.neutral, config.arbiter.stick.human_scale) == (1, 4915, 0.3)


@pytest.mark.parametrize("before, after, said", [
    ("profile: unverified", "profile: fast", "esc/profile is 'fast'; accepted: one of brake_then_reverse"),
    ("expo: 0.0", "expoo: 0.0", "expoo"),
    ("command_timeout: 0.5", "command_timeout: x", "command_timeout is 'x'"),
])
def test_file_that_the_node_would_refuse_is_refused_with_its_name(tmp_path, before, after, said):
    text = SHIPPED.read_text(encoding="utf-8")
    assert before in text
    path = tmp_path / "throttle.yaml"
    path.write_text(text.replace(before, after), encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_throttle(str(path))
    assert str(path) in str(refused.value) and said in str(refused.value)


def test_what_needs_other_files_is_left_out_of_a_file_that_is_read_alone(tmp_path):
    text = SHIPPED.read_text(encoding="utf-8")
    path = tmp_path / "throttle.yaml"
    for before, after in (("obstacle_stop: false", "obstacle_stop: true"), ("max_braking: 0", "max_braking: 3")):
        assert before in text
        text = text.replace(before, after)
    path.write_text(text, encoding="utf-8")
    config = load_throttle(str(path))
    assert (config.obstacles, config.limits.value_map) == (None, None)
    assert config.limits.planner.max_braking_mps2 == 3
