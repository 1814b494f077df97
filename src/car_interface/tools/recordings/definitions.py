"""Deserializes recorded messages, by the recording's own definitions or by those that are known here.

ROS 1 bags always contain their definitions, ROS 2 bags since Iron. For older ones there are the standard types of ROS 2
Humble, those in this package's ``msg`` folder, Autoware's equivalents of these, ackermann_msgs, and a VESC's telemetry.
"""
from __future__ import annotations

from functools import lru_cache
from typing import Any, Callable

from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file

PACKAGE = "car_interface"
# Autoware's packages with messages that have the fields of ours.
EQUIVALENTS = {
    "autoware_control_msgs": ("Control", "Lateral", "Longitudinal"),
    "autoware_internal_debug_msgs": ("Float64Stamped",),
    "tier4_debug_msgs": ("Float64Stamped",),
}
# Common types that ROS 2 itself doesn't have.
OTHERS = {
    "ackermann_msgs/msg/AckermannDrive": "\n".join(f"float32 {name}" for name in (
        "steering_angle", "steering_angle_velocity", "speed", "acceleration", "jerk")),
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\nackermann_msgs/AckermannDrive drive",
    # As F1TENTH's ROS 2 driver has it; cars with a Humble or an older ROS 2 record it without its definition.
    "vesc_msgs/msg/VescState": "\n".join(f"{kind} {name}" for kind, names in (
        ("float64", "temp_fet temp_motor current_motor current_input avg_id avg_iq duty_cycle speed"),
        ("float64", "voltage_input charge_drawn charge_regen energy_drawn energy_regen"),
        ("int32", "displacement distance_traveled fault_code"), ("float64", "pid_pos_now"), ("int32", "controller_id"),
        ("float64", "ntc_temp_mos1 ntc_temp_mos2 ntc_temp_mos3 avg_vd avg_vq")) for name in names.split()),
    "vesc_msgs/msg/VescStateStamped": "std_msgs/Header header\nvesc_msgs/VescState state",
}
IDL_RULE = "=" * 80 + "\n"


class UnknownType(CarInterfaceError):
    """A message type without a definition in the recording or here."""


def decoder(connection, is_ros2: bool) -> Callable[[bytes], Any]:
    """Return a function from the bytes of one connection's messages to messages.

    Args:
        is_ros2: whether the bytes are CDR, as ROS 2 has them.

    Raises:
        UnknownType: neither the recording nor this package has its definition.
    """
    name, (text, is_idl) = connection.msgtype, _definition(connection)
    store = _store(name, text, is_idl) if text else known_types()
    try:
        store.get_msgdef(name)
    except (KeyError, TypesysError) as error:
        raise UnknownType(f"neither the recording nor this package knows all of its type {name}") from error
    deserialize = store.deserialize_cdr if is_ros2 else store.deserialize_ros1
    return lambda data: deserialize(data, name)


@lru_cache(maxsize=1)
def known_types() -> Any:
    """Return the types of ROS 2 Humble, of this package, Autoware's equivalents, and OTHERS, as rosbags' typestore."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: dict = {}
    for path in sorted(package_file("msg").glob("*.msg")):
        text = path.read_text(encoding="utf-8")
        types.update(get_types_from_msg(text, f"{PACKAGE}/msg/{path.stem}"))
        for package, names in EQUIVALENTS.items():
            if path.stem in names:
                types.update(get_types_from_msg(text, f"{package}/msg/{path.stem}"))
    for name, text in OTHERS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


@lru_cache(maxsize=200)  # parsing takes longer than reading a small recording, and all of a car have the same ones
def _store(name, text, is_idl):
    store = get_typestore(Stores.EMPTY)
    try:
        if not is_idl:
            store.register(get_types_from_msg(text, name))
        elif text.startswith(IDL_RULE):
            for part in text.split(IDL_RULE)[1:]:
                store.register(get_types_from_idl(part.split("\n", 1)[1]))
        else:
            store.register(get_types_from_idl(text))
    except Exception as error:  # a parser may stumble over anything in a damaged text
        raise UnknownType(f"the recording's definition of its type {name} makes no sense") from error
    return store


def _definition(connection):
    """Return the text of a definition, empty when the recording has none, and whether it's in IDL."""
    definition = connection.msgdef
    if isinstance(definition, str):  # rosbags before 0.10
        return definition, definition.startswith(IDL_RULE + "IDL: ")
    return definition.data, definition.format.name == "IDL"
