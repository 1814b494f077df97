"""The service ~save: writes tuned values into the YAML file that the node starts with.

It runs in a thread of ROS, and writes only the file that a parameter named at start.

Service:
    ~save (std_srvs/Trigger): a backup of the old file stays in its folder, under a name with the time.
"""
from __future__ import annotations

import os
import threading
from typing import Callable

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import TuningSettings
from car_interface.common.package_files import is_package_file
from car_interface.common.yaml_edit import Values, save
from car_interface.ros.inbox import Inbox


def serve_saving(inbox: Inbox, settings: TuningSettings, values: Callable[[], Values]) -> None:
    """Offer ~save.

    Args:
        inbox: the node's.
        settings: the file, which the parameter ~save_to names, and whether it may be one of the package's own.
        values: returns what to save, by the names in the file; called in a thread of ROS.
    """
    one_at_a_time = threading.Lock()

    def answer(_request):
        with one_at_a_time:
            success, message = _save(settings, values())
        (rospy.loginfo if success else rospy.logwarn)("save: %s", message)
        return TriggerResponse(success=success, message=message)

    inbox.on_close(inbox.graph.service(inbox.own_name("~save"), Trigger, answer).shutdown)


def _save(settings, values):
    """Whether it succeeded, and a line about it."""
    path = settings.save_to
    if path is None:
        return False, f"{' and '.join(values)} not saved: the parameter ~save_to names no file"
    if not settings.saves_to_package and is_package_file(path):
        folder = os.path.dirname(path)
        return False, (f"not saved: {path} is the package's own, which the demo leaves as it is. Copy the folder "
                       f"(cp -r {folder} ~/my_car) and start the demo with config:=$HOME/my_car")
    try:
        backup_path = save(path, values)
    except ConfigError as error:
        return False, f"not saved: {error}"
    if backup_path is None:
        return True, f"{path} says so already"
    return True, f"saved to {path}, the old one is {backup_path}"
