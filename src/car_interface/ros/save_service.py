"""The service ~save: what was tuned while a node ran goes into the YAML file that it will start from.

It is the only way by which a message makes a node write a file, it runs in a thread of ROS's, and it writes only to
what a parameter named at start.

Service:
    ~save (std_srvs/Trigger): the old file stays beside the new one, under a name with the time.
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
    """What shall be saved where."""

    parameter: str  # that named the file
    path: str | None
    values: Values  # by the names that they have in it


def serve_saving(inbox: Inbox, files: Callable[[], list[File]], follower: str | None = None) -> None:
    """Offer ~save.

    Args:
        inbox: the node's.
        files: what to save; asked for in a thread of ROS's.
        follower: a service of the same kind, which is called afterwards if it's there.
    """
    one_at_a_time = threading.Lock()

    def answer(_request):
        with one_at_a_time:
            told = [_save(file) for file in files()]
            if follower is not None and all(well for well, _ in told):
                told.append(_save_too(follower))
        response = TriggerResponse(success=all(well for well, _ in told),
                                   message="; ".join(text for _, text in told) or "there is nothing to save")
        (rospy.loginfo if response.success else rospy.logwarn)("save: %s", response.message)
        return response

    inbox.on_close(rospy.Service(inbox.resolve_name("~save"), Trigger, answer).shutdown)


def _save(file):
    """Whether it went well, and the line about it."""
    if file.path is None:
        return False, f"{' and '.join(file.values)} not saved: the parameter ~{file.parameter} names no file"
    try:
        aside = save(file.path, file.values)
    except ConfigError as error:
        return False, f"not saved: {error}"
    if aside is None:
        return True, f"{file.path} says so already"
    return True, f"saved to {file.path}, the old one is {aside}"


def _save_too(service):
    """Have the one who follows save as well; whether it went well, and the line about it."""
    name = rospy.resolve_name(service)
    try:
        rospy.wait_for_service(service, FOLLOWER_WITHIN_S)
        response = rospy.ServiceProxy(service, Trigger)()
    except rospy.ROSException:
        return True, f"{name} isn't there to be asked"
    except (rospy.ServiceException, OSError) as error:
        return False, f"{name} failed: {error}"
    return response.success, f"{name}: {response.message}"
