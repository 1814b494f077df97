"""Lock and deadman, as every node that moves something hears them."""
from __future__ import annotations

from std_msgs.msg import Bool

from car_interface.ros.topics import subscribe_changes


def subscribe_interlock(inbox, arbiter, then=None) -> None:
    """Have ``arbiter`` hear the lock (/e_stop) and the deadman (/teleop_logi/human_in_loop), in the node's thread.

    The node must beat: what these two repeat waits for its next beat. After news ``then(arrival_ns)`` is called.
    """
    subscribe_changes("/e_stop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_e_stop(message.data, now_ns), then)
    subscribe_changes("/teleop_logi/human_in_loop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_human(message.data, now_ns), then)
