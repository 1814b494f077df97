"""The subscriptions of every node with a motion interlock: emergency stop and deadman."""
from __future__ import annotations

from std_msgs.msg import Bool

from car_interface.ros.topics import subscribe_changes


def subscribe_interlock(inbox, arbiter, on_change=None) -> None:
    """Pass /e_stop and /teleop_logi/human_in_loop to ``arbiter``, in the node's thread.

    Repeated values are handled at the node's next timer tick; after a new value ``on_change(arrival_ns)`` is called.
    An emergency stop may be latched and sent once (``e_stop_timeout`` 0), a deadman is repeated.
    """
    subscribe_changes("/e_stop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_e_stop(message.data, now_ns), on_change,
                      takes_latched=True)
    subscribe_changes("/teleop_logi/human_in_loop", Bool, inbox,
                      lambda message, now_ns: arbiter.update_human(message.data, now_ns), on_change)
