"""The service ~save: writes tuned values into the YAML file that the node starts with.

It runs in a thread of ROS, and writes only the file that a parameter named at start.

Service:
    ~save (std_srvs/Trigger): a backup of the old file stays in its folder, under a name with the time.
"""
from __future__ import annotations

import threading
from typing import Callable

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import Values, save
from car_interface.ros.inbox import Inbox


def serve_saving(inbox: Inbox, path: str | None, values: Callable[[], Values]) -> None:
    """Offer ~save.

    Args:
        inbox: the node's.
        path: the file, which the parameter ~save_to names; ``None`` = nowhere.
        values: returns what to save, by the names in the file; called in a thread of ROS.
    """
    one_at_a_time = threading.Lock()

    def answer(_request):
        with one_at_a_time:
            success, message = _save(path, values())
        (rospy.loginfo if success else rospy.logwarn)("save: %s", message)
        return TriggerResponse(success=success, message=message)

    inbox.on_close(rospy.Service(inbox.resolve_name("~save"), Trigger, answer).shutdown)


def _save(path, values):
    """Whether it succeeded, and a line about it."""
    if path is None:
        return False, f"{' and '.join(values)} not saved: the parameter ~save_to names no file"
    try:
        backup_path = save(path, values)
    except ConfigError as error:
        return False, f"not saved: {error}"
    if backup_path is None:
        return True, f"{path} says so already"
    return True, f"saved to {path}, the old one is {backup_path}"
