"""The service ~save: writes tuned values into the YAML file that the node starts with.

It runs in a thread of ROS, and writes only files that a parameter named at start.

Service:
    ~save (std_srvs/Trigger): a backup of the old file stays in its folder, under a name with the time.
"""
from __future__ import annotations

import threading
from typing import Callable, NamedTuple

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import Values, save
from car_interface.ros.inbox import Inbox

FOLLOWER_WITHIN_S = 1.0


class File(NamedTuple):
    """A file to save to."""

    parameter: str  # the one that names the file
    path: str | None
    values: Values  # by their names in the file


def serve_saving(inbox: Inbox, files: Callable[[], list[File]], follower: str | None = None) -> None:
    """Offer ~save.

    Args:
        inbox: the node's.
        files: returns what to save; called in a thread of ROS.
        follower: a service of the same kind, which is called afterwards if it exists.
    """
    one_at_a_time = threading.Lock()

    def answer(_request):
        with one_at_a_time:
            results = [_save(file) for file in files()]
            if follower is not None and all(success for success, _ in results):
                results.append(_call_follower(follower))
        response = TriggerResponse(success=all(success for success, _ in results),
                                   message="; ".join(text for _, text in results) or "there is nothing to save")
        (rospy.loginfo if response.success else rospy.logwarn)("save: %s", response.message)
        return response

    inbox.on_close(rospy.Service(inbox.resolve_name("~save"), Trigger, answer).shutdown)


def _save(file):
    """Whether it succeeded, and a line about it."""
    if file.path is None:
        return False, f"{' and '.join(file.values)} not saved: the parameter ~{file.parameter} names no file"
    try:
        backup_path = save(file.path, file.values)
    except ConfigError as error:
        return False, f"not saved: {error}"
    if backup_path is None:
        return True, f"{file.path} says so already"
    return True, f"saved to {file.path}, the old one is {backup_path}"


def _call_follower(service):
    """Call the follower's ~save; whether it succeeded, and a line about it."""
    name = rospy.resolve_name(service)
    try:
        rospy.wait_for_service(service, FOLLOWER_WITHIN_S)
        response = rospy.ServiceProxy(service, Trigger)()
    except rospy.ROSException:
        return True, f"{name} isn't there to be asked"
    except (rospy.ServiceException, OSError) as error:
        return False, f"{name} failed: {error}"
    return response.success, f"{name}: {response.message}"
