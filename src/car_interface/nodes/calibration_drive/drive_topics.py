"""What a calibration drive records: all that the calibrations and bag_report read, and no cameras."""
from __future__ import annotations

from car_interface.common.vehicle_geometry import SONARS

TOPICS = (
    "odom", "joint_states", "imu/data", "car_sim/truth", "servo/output", "servo/cmdVector", "e_stop", "joy",
    "turn_arb/state", "throttle_arb/state", "planner_interface/state", "generic_value_converter/state",
    "av_steer_req", "av_speed_req", "planner_interface/output/control_cmd", "generic/output/value",
    "teleop_logi/state", "teleop_logi/human_in_loop", "teleop_logi/mode", "teleop_logi/tele_steer_req",
    "teleop_logi/tele_throt_req", "teensy_sensor_hub/link", "teensy_clock", "teensy_pong", "teensy_wheel",
    "teensy_distance", "teensy_error", *(f"sonar/{name}" for name in SONARS), "/tf", "/tf_static", "/diagnostics",
    "/rosout")


def recorded_topics(inbox) -> list[str]:
    """Return their resolved names, in a node's namespace."""
    return [inbox.resolve_name(topic) for topic in TOPICS]
