"""Lock and deadman, as every node that moves something hears them."""
from __future__ import annotations

from std_msgs.msg import Bool

from car_interface.nodes.node import subscribe_changes
from car_interface.permission import PermissionConfig

HUMAN_TIMEOUT_S = 0.5


def read_permission(params, human_timeout_s: float = HUMAN_TIMEOUT_S) -> PermissionConfig:
    """The rules from ~human_timeout (with this default), ~e_stop_timeout and ~e_stop_required."""
    return PermissionConfig(human_timeout_s=params.timeout("human_timeout", human_timeout_s),
                            e_stop_timeout_s=params.timeout("e_stop_timeout", 1.0),
                            e_stop_required=params.flag("e_stop_required", False))


def subscribe_permission(inbox, arbiter) -> None:
    """Have ``arbiter`` hear the lock (/e_stop) and the deadman (/teleop_logi/human_in_loop), in the node's thread.

    The node must beat: what these two repeat waits for its next beat.
    """
    subscribe_changes("/e_stop", Bool, inbox,
                      lambda message, now_ns: arbiter.hear_e_stop(message.data, now_ns))
    subscribe_changes("/teleop_logi/human_in_loop", Bool, inbox,
                      lambda message, now_ns: arbiter.hear_human(message.data, now_ns))
