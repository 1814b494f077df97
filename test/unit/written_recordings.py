"""Writes small recordings of every kind that rosbags knows, and a drive in which a lot happens."""
from __future__ import annotations

import functools
import math
import sqlite3
from pathlib import Path
from typing import Any, Iterable, NamedTuple

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from car_interface.common import causes

ROOT = Path(__file__).resolve().parents[2]
START_NS = 1_700_000_000 * 1_000_000_000
BASE, NAME, ARRAY, SEQUENCE = range(1, 5)  # kinds of fields, as rosbags has them


class Written(NamedTuple):
    """One message to be written; fields that are left out are 0 or empty."""

    time_s: float
    topic: str
    type: str  # such as nav_msgs/Odometry
    fields: dict


def write_ros1(path: Path, messages: Iterable[Written], chunk_bytes: int | None = None, extra_types=()) -> Path:
    """A ROS 1 bag."""
    store = typestore(Stores.ROS1_NOETIC, extra_types)
    with Ros1Writer(path) as writer:
        if chunk_bytes is not None:
            writer.chunk_threshold = chunk_bytes
        _write(writer, store, store.serialize_ros1, messages)
    return path


def _write(writer, store, serialize, messages):
    connections: dict = {}
    for message in messages:
        name = full(message.type)
        if (message.topic, name) not in connections:
            connections[message.topic, name] = writer.add_connection(message.topic, name, typestore=store)
        writer.write(connections[message.topic, name], START_NS + round(message.time_s * 1e9),
                     serialize(made(store, name, message.fields), name))


def write_ros2(path: Path, messages: Iterable[Written], with_definitions: bool = True, extra_types=()) -> Path:
    """A ROS 2 bag in SQLite, the folder's path."""
    store = typestore(Stores.ROS2_HUMBLE, extra_types)
    try:
        writer = Ros2Writer(path, version=8)
    except TypeError:  # rosbags before 0.10
        writer = Ros2Writer(path)
    with writer:
        _write(writer, store, store.serialize_cdr, messages)
    if not with_definitions:
        (database,) = path.glob("*.db3")
        with sqlite3.connect(str(database)) as connection:
            connection.execute("DELETE FROM message_definitions")
        connection.close()
    return path


def typestore(kind: Stores, extra_types: Iterable[tuple[str, str]] = ()) -> Any:
    """The standard types, this package's, and others given as (name, definition)."""
    return _typestore(kind, tuple(extra_types))


@functools.lru_cache(maxsize=None)
def _typestore(kind, extra_types):
    store = get_typestore(kind)
    types: dict = {}
    for file in sorted((ROOT / "msg").glob("*.msg")):
        types.update(get_types_from_msg(file.read_text(encoding="utf-8"), f"car_interface/msg/{file.stem}"))
    if kind == Stores.ROS1_NOETIC:  # rosbags' lacks this one
        extra_types = (*extra_types, ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms"))
    for name, text in extra_types:
        types.update(get_types_from_msg(text, full(name)))
    store.register(types)
    return store


def full(name: str) -> str:
    """A type's name as ROS 2 has it."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


def made(store: Any, name: str, fields: dict) -> Any:
    """A message of these fields; the others are 0 or empty."""
    definitions = store.fielddefs if hasattr(store, "fielddefs") else store.FIELDDEFS
    values = {field: _value(store, kind, fields.get(field)) for field, kind in definitions[name][1]}
    assert not set(fields) - set(values), f"{name} has no {set(fields) - set(values)}"
    return store.types[name](**values)


@functools.lru_cache(maxsize=None)
def _empty(store, name):
    return made(store, name, {})


def _value(store, kind, value):
    node, inside = kind
    if node == BASE:
        empty = "" if inside[0] == "string" else False if inside[0] == "bool" else 0.0 if "float" in inside[0] else 0
        return empty if value is None else value
    if node == NAME:
        return made(store, inside, value) if value else _empty(store, inside)
    element, length = inside
    if element[0] == BASE and element[1][0] != "string":
        return np.array([0] * (length if node == ARRAY else 0) if value is None else value, element[1][0])
    return [_value(store, element, part) for part in (value or [])]


# --- a drive ---


def stamp(time_s: float) -> dict:
    """A time of a message."""
    seconds, nanoseconds = divmod(START_NS + round(time_s * 1e9), 1_000_000_000)
    return {"sec": seconds, "nanosec": nanoseconds}


def odometry(time_s: float, x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=0.0, topic="/odom") -> Written:
    """One of the wheels' messages."""
    turn = {"z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}
    return Written(time_s, topic, "nav_msgs/Odometry", {
        "header": {"stamp": stamp(time_s), "frame_id": "odom"}, "child_frame_id": "base_link",
        "pose": {"pose": {"position": {"x": x_m, "y": y_m}, "orientation": turn}},
        "twist": {"twist": {"linear": {"x": speed_mps}}}})


def output(time_s: float, *duties: float, topic="/servo/output") -> Written:
    """The duties of the servo board's first channels; the others have none."""
    return Written(time_s, topic, "std_msgs/Int32MultiArray", {
        "data": [*map(round, duties), *[-1] * (16 - len(duties))]})


ANGLE, STAMPED_ANGLE = "ackermann_msgs/AckermannDrive", "ackermann_msgs/AckermannDriveStamped"
ACKERMANN = [(ANGLE, "\n".join(f"float32 {name}" for name in (
    "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk"))),
    (STAMPED_ANGLE, f"std_msgs/Header header\n{ANGLE} drive")]
NO_HUMAN, NEUTRAL, TELEOP, PLANNER = 1, 2, 3, 4
SPEED_MPS, RADIUS_M = 1.5, 2.0
HOSTILE = '<script>document.title = "owned"</script> & "quotes" </svg>'


def drive(duration_s: float = 60.0, namespace: str = "") -> list[Written]:
    """By gamepad straight on, then by the planner to the left, on a circle that the car makes 10 % wider.

    At 40 s the planner's messages end, at 50 s the Teensy's for two seconds; at 45 s a node logs a hostile text.
    """
    below = namespace.rstrip("/")
    messages = [Written(0.0, "/tf_static", "tf2_msgs/TFMessage", {"transforms": [
        {"child_frame_id": "sonar_front_middle",
         "transform": {"translation": {"x": 0.42}, "rotation": {"w": 1.0}}}]})]
    x_m = y_m = yaw_rad = 0.0
    for step in range(int(duration_s * 50)):
        time_s = step / 50
        stands = time_s < 5 or time_s >= 40
        speed_mps = 0.0 if stands else SPEED_MPS
        sent = 1 / RADIUS_M if 20 <= time_s < 40 else 0.0
        yaw_rad += speed_mps * sent / 1.1 / 50
        x_m += speed_mps * math.cos(yaw_rad) / 50
        y_m += speed_mps * math.sin(yaw_rad) / 50
        messages.append(odometry(time_s, x_m, y_m, yaw_rad, speed_mps, f"{below}/odom"))
        duties = [0] * 16
        duties[2], duties[3] = (4912 if stands else 5200), (3840 if sent else 5088)
        if step % 5 == 0:
            source, cause, reason = (
                (NO_HUMAN, causes.HUMAN_ABSENT, "human_in_loop is false") if time_s < 5 else
                (TELEOP, causes.TELEOP, f"tele_steer_req is {0.1 + time_s / 1000:.3f}") if time_s < 20 else
                (PLANNER, causes.PLANNER, "av_turnrad_req is 2.000 m") if time_s < 40 else
                (NEUTRAL, causes.PLANNER_STALE, f"av_turnrad_req silent for {time_s - 39.5:.2f} s"))
            messages.append(Written(time_s, f"{below}/turn_arb/state", "car_interface/SteeringState", {
                "stamp": stamp(time_s), "source": source, "cause": cause, "reason": reason,
                "duty": 3846 if sent else 5100, "channel": 3, "turn_radius": RADIUS_M if sent else math.inf}))
            messages.append(Written(time_s, f"{below}/servo/output", "std_msgs/Int32MultiArray", {"data": duties}))
            messages.append(Written(time_s, f"{below}/generic/output/value", "car_interface/Float64Stamped", {
                "stamp": stamp(time_s), "data": 0.0 if stands else 0.7}))
            if 20 <= time_s < 39.5:
                messages.append(Written(time_s, f"{below}/av_turnrad_req", "std_msgs/Float32", {"data": RADIUS_M}))
            messages.append(Written(time_s, f"{below}/teleop_logi/tele_steer_req", "std_msgs/Float32",
                                    {"data": 0.1 if 5 <= time_s < 20 else 0.0}))
        if step % 15 == 0:
            messages.append(Written(time_s, f"{below}/sonar/front_middle", "sensor_msgs/Range", {
                "header": {"stamp": stamp(time_s), "frame_id": "sonar_front_middle"}, "min_range": 0.02,
                "max_range": 2.0, "range": 0.8 if 10 < time_s < 11 else math.inf}))
        if step % 50 == 0:
            silent = 50 <= time_s < 52
            messages += _every_second(time_s, below, silent)
    messages.append(Written(45.0, "/rosout", "rosgraph_msgs/Log", {
        "header": {"stamp": stamp(45.0)}, "level": 8, "name": "/pca9685", "msg": HOSTILE}))
    messages.append(Written(45.1, "/rosout", "rosgraph_msgs/Log", {"level": 2, "name": "/pca9685", "msg": "all fine"}))
    return sorted(messages, key=lambda message: message.time_s)


def _every_second(time_s, below, silent):
    second = int(time_s)
    counters = [{"name": "txPackets", "count": 100 * second}, {"name": "rxErrorChecksum", "count": 7}]
    yield Written(time_s, f"{below}/teensy_sensor_hub/link", "car_interface/LinkStatus", {
        "stamp": stamp(time_s), "open": True, "level": 2 if silent else 0, "state": "silent" if silent else "fine",
        "words": "nothing comes" if silent else "", "next_step": "look at its power" if silent else "",
        "frames": 90 * second, "bad_frames": second // 20, "pings": second + 1, "pongs": second,
        "reboots": int(time_s >= 52), "round_trip": 0.004, "firmware_checksum": "shipped", "counters": counters})
    # The computer's clock is set by a quarter of a second at 30 s.
    monotonic_ns = round(time_s * 1e9) + 5_000_000_000 - (250_000_000 if time_s >= 30 else 0)
    yield Written(time_s, f"{below}/teensy_clock", "car_interface/TeensyClock", {
        "stamp": stamp(time_s), "sent": monotonic_ns - 4_000_000, "received": monotonic_ns, "used": True,
        "converged": True, "skew": 12.5, "uncertainty": 0.0006, "round_trip": 0.004})
    status = [{"name": "pca9685: servo board", "level": 2 if 25 <= time_s < 28 else 0,
               "message": f"nothing answers, {second} times" if 25 <= time_s < 28 else "fine"},
              {"name": "turn_arb: steering", "level": 1, "message": "told by turn_arb/state"}]
    yield Written(time_s, "/diagnostics", "diagnostic_msgs/DiagnosticArray",
                  {"header": {"stamp": stamp(time_s)}, "status": status})
