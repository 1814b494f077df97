"""Files of a car that differs in everything: channels, a reversed servo, ESC, wheels, gamepad."""
from __future__ import annotations

import shutil
from pathlib import Path

import yaml


def copy_another_car(shipped: Path, folder: Path) -> None:
    """Make a folder with the shipped files, changed."""
    shutil.copytree(str(shipped), str(folder))
    steering, throttle = (yaml.safe_load((shipped / name).read_text(encoding="utf-8"))
                          for name in ("turn_arb.yaml", "throttle.yaml"))
    left, right = (steering[f"k_pwmcmd_{side}_table_servo"] for side in ("left", "right"))
    servo = throttle["servo"]
    for name, changes in (
            ("turn_arb.yaml", {"servo_channel": 6, "servo_left": 6600, "servo_center": 5200, "servo_right": 3900,
                               "k_pwmcmd_left_table_servo": [*(duty - 100 for duty in right[:-1]), 5200],
                               "k_pwmcmd_right_table_servo": [duty + 100 for duty in left]}),
            ("throttle.yaml", {"servo": {**servo, "channel": 9, "neutral": servo["neutral"] + 80,
                                         "duty_table": [duty + 80 for duty in servo["duty_table"]]}}),
            ("teensy_sensor_hub.yaml", {"wheel_diameter": 0.12, "track": 0.25, "pulses_per_revolution": 12}),
            ("teleop_logi.yaml", {"steer_axis": 9, "manual_button": 1, "autonomous_button": 12, "steer_scale": -1.0})):
        values = yaml.safe_load((shipped / name).read_text(encoding="utf-8"))
        (folder / name).write_text(yaml.safe_dump({**values, **changes}), encoding="utf-8")
