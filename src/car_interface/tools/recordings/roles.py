"""Finds the topic that plays a role: as the user says, by its usual name, or as the only one of its type.

A guess is made for a few types only, and never between two topics; it always comes with a line that says so.
"""
from __future__ import annotations

from types import MappingProxyType
from typing import Mapping, NamedTuple

from car_interface.tools.recordings.recording import Topic, absolute_names, is_of_type, prefix

VALUE_TYPES = ("car_interface/Float64Stamped", "autoware_internal_debug_msgs/Float64Stamped",
               "tier4_debug_msgs/Float64Stamped", "tier4_debug_msgs/Float32Stamped", "std_msgs/Float64",
               "std_msgs/Float32")
DUTY_TYPES, NUMBER_TYPES = ("std_msgs/Int32MultiArray",), ("std_msgs/Float32",)
VESC_TYPES, VESC_NUMBER_TYPES = ("vesc_msgs/VescStateStamped",), ("std_msgs/Float64",)
# A namespace with one of these is a car of its own: nothing of it is guessed to be another car's.
CAR_ENDINGS = ("/turn_arb/state", "/servo/output")
THROTTLE_STATE = {"throttle_arb/state": "car_interface/ThrottleState"}  # who drives, and what the ESC does


class Role(NamedTuple):
    """What a topic is needed for."""

    name: str  # as in --map TOPIC=NAME
    topics: tuple[str, ...]  # its usual names, the first that was recorded counts
    types: tuple[str, ...]  # that are accepted
    what: str
    is_guessed: bool = False  # whether the only topic of such a type is taken where no usual name was recorded
    preferred: tuple[str, ...] = ()  # names that go before the usual ones where the user names none


def _of_vesc(*topics):
    """Return topics of a VESC's nodes, which F1TENTH's ROS 1 launch files put below ``vesc``, ROS 2's don't."""
    return tuple(name for topic in topics for name in (topic, f"vesc/{topic}"))


ODOM = Role("odom", _of_vesc("odom"), ("nav_msgs/Odometry",), "pose and speed", True)
IMU = Role("imu", ("imu/data",), ("sensor_msgs/Imu",), "turn rate and acceleration, z up, x forward", True)
OUTPUT = Role("output", ("/servo/output",), DUTY_TYPES, "the 16 duties that the servo board outputs")
COMMAND = Role("command", ("/servo/cmdVector", "command"), DUTY_TYPES, "the 16 duties that it was sent, -1 = as before")
VALUE = Role("value", ("generic/output/value", *_of_vesc("commands/motor/duty_cycle", "sensors/core")),
             (*VALUE_TYPES, *VESC_TYPES),
             "what drives the car, a number (no AckermannDrive: it asks for a speed), or a VESC's duty cycle")
ACKERMANN = Role("ackermann", ("drive", "ackermann_cmd", "vesc/low_level/ackermann_cmd_mux/output"),
                 ("ackermann_msgs/AckermannDriveStamped", "ackermann_msgs/AckermannDrive"),
                 "steering angle and speed that a planner asks for", True)
RADIUS = Role("radius", ("av_turnrad_req",), NUMBER_TYPES, "turn radius in m that a planner asks for, left positive")
ACCELERATION = Role("acceleration", ("control/command/control_cmd",),
                    ("car_interface/Control", "autoware_control_msgs/Control"),
                    "acceleration that a planner asks for, or its speed control", True,
                    # With planner_interface this one is what the value map gets; Autoware's is what that gets.
                    preferred=("planner_interface/output/control_cmd",))
BATTERY = Role("battery", ("battery_state",), ("sensor_msgs/BatteryState",), "the battery's voltage", True)
VESC = Role("vesc", _of_vesc("sensors/core"), VESC_TYPES, "a VESC's voltage, duty cycle and motor speed", True)
SERVO = Role("servo", _of_vesc("sensors/servo_position_command", "commands/servo/position"), VESC_NUMBER_TYPES,
             "position of a VESC's servo, 0 to 1")
MOTOR = Role("motor", _of_vesc("commands/motor/speed"), VESC_NUMBER_TYPES, "speed that a VESC is asked for, in ERPM")
STICK = Role("stick", ("/teleop_logi/tele_steer_req",), NUMBER_TYPES, "steering by the gamepad, -1 to 1")


class Found(NamedTuple):
    """The topic for a role."""

    topic: str  # for recording.read; it may be missing all the same
    note: str = ""  # of a guess, or why none was made
    is_there: bool = False  # whether it was recorded, and the user gave it to no other role
    fits: bool = False  # whether its type is accepted, too


def find(recorded: Mapping[str, Topic], role: Role, namespace: str = "/",
         given: Mapping[str, str] = MappingProxyType({})) -> Found:
    """Find the topic for a role.

    Args:
        given: topics by the roles that the user gave them to. They play no other role, and one for this role goes
            before everything else.
    """
    named = given.get(role.name)
    taken = absolute_names(recorded, [topic for name, topic in given.items() if name != role.name], namespace)
    free = {name: topic for name, topic in recorded.items() if name not in taken}
    topic, note = (named, "") if named not in (None, role.topics[0]) else _usual_or_guessed(
        free, role, namespace, role.topics if named else (*role.preferred, *role.topics))
    return Found(topic, note, bool(absolute_names(free, [topic], namespace)), _fits(free, topic, role, namespace))


def _usual_or_guessed(free, role, namespace, usual_names):
    """Return the topic for a role among those that are free, and a note."""
    with_messages = {name: topic for name, topic in free.items() if topic.count}
    usual = next((topic for topic in usual_names if _fits(with_messages, topic, role, namespace)), None)
    candidates = []
    if role.is_guessed and usual is None:
        below = prefix(namespace)
        others = tuple(space + "/" for space in other_cars(free, namespace) if not below.startswith(space + "/"))
        candidates = [name for name, topic in with_messages.items() if is_of_type(topic.type, role.types)
                      and name.startswith(below) and not name.startswith(others)]
    if not candidates:
        there = (topic for topic in role.topics if absolute_names(free, [topic], namespace))
        return usual or next(there, role.topics[0]), ""
    kind = free[candidates[0]].type.replace("/msg/", "/")
    if len(candidates) == 1:
        return candidates[0], f"{role.name}: {candidates[0]} (the only {kind})"
    return role.topics[0], (f"{role.name}: there are {' and '.join(candidates)}, and no {role.topics[0]}; say "
                            f"which by --map, as in --map {candidates[0]}={role.name}")


def _fits(recorded, topic, role, namespace):
    """Return whether a topic, as for ``recording.read``, was recorded with a type that its role accepts."""
    return any(is_of_type(recorded[name].type, role.types) for name in absolute_names(recorded, [topic], namespace))


def other_cars(recorded: Mapping[str, Topic], namespace: str) -> set[str]:
    """Return the namespaces with cars of their own, such as ``/car1``, other than ``namespace``."""
    spaces = {name[:-len(ending)] for name in recorded for ending in CAR_ENDINGS if name.endswith(ending)}
    return spaces - {"", "/" + namespace.strip("/")}
