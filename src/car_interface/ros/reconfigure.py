"""Live tuning of a node's calibration by dynamic_reconfigure, and ~save, which writes it to the YAML file.

Requests arrive in a thread of ROS, which passes them to the node's thread and waits for its answer: only the node's
thread changes active values.

Services:
    ~set_parameters (dynamic_reconfigure/Reconfigure), below ``namespace``, with the topics parameter_descriptions and
        parameter_updates: the interface of rqt_reconfigure.
    ~save (std_srvs/Trigger): writes the values into the YAML file that ~save_to named at start. A backup of the old
        file stays in its folder, under a name with the time.
"""
from __future__ import annotations

import os
import threading
from concurrent.futures import TimeoutError as NoAnswer
from contextlib import suppress
from types import SimpleNamespace
from typing import Callable, Mapping

import rospy
from dynamic_reconfigure.encoding import encode_config, encode_description
from dynamic_reconfigure.msg import Config, ConfigDescription, GroupState
from dynamic_reconfigure.srv import Reconfigure, ReconfigureRequest, ReconfigureResponse
from std_srvs.srv import Trigger, TriggerResponse

from car_interface.common.errors import ConfigError
from car_interface.common.live_parameters import Tuning, TuningSettings
from car_interface.common.package_files import is_package_file
from car_interface.common.yaml_edit import Values, save
from car_interface.ros.inbox import Inbox
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.topics import advertise, subscribe

ANSWER_WITHIN_S = 2.0
SETTLE_WITHIN_S = 5.0


class ReconfigureServer:
    """A node's tunable values.

    Args:
        warnings: the node's; clamped and refused requests are counted there.
        tuning: the values, their limits and rate.
        apply: makes values active; called in the node's thread.
        parameters: all parameters that result from such values, by their names in the node's namespace and in its file;
            called in any thread.
        config_class: the class that catkin made of a .cfg file.
        settings: where values are saved, and whether that may be one of the package's own files.
        namespace: of dynamic_reconfigure's parameters, below the node's.
    """

    def __init__(self, inbox: Inbox, warnings: ThrottledWarnings, tuning: Tuning,
                 apply: Callable[[Mapping[str, int]], None], parameters: Callable[[Mapping[str, int]], Values],
                 config_class, settings: TuningSettings, namespace: str = ""):
        self._inbox = inbox
        self._warnings = warnings
        self._tuning = tuning
        self._apply = apply
        self._parameters = parameters
        self._settings = settings
        self._one_request, self._one_save = threading.Lock(), threading.Lock()
        self._has_set_parameters = False  # whether the parameter server has tuned values
        apply(tuning.active)
        prefix = f"~{namespace}/" if namespace else "~"
        advertise(f"{prefix}parameter_descriptions", ConfigDescription, inbox, latch=True).publish(
            encode_description(SimpleNamespace(min=tuning.low, max=tuning.high, defaults=tuning.accepted,
                                               config_description=config_class.config_description)))
        self._updates = advertise(f"{prefix}parameter_updates", Config, inbox, latch=True)
        self._updates.publish(self._config())
        for name, service_type, handler in ((f"{prefix}set_parameters", Reconfigure, self._on_reconfigure),
                                            ("~save", Trigger, self._on_save)):
            inbox.on_close(inbox.graph.service(inbox.own_name(name), service_type, handler).shutdown)

    def step(self, now_ns: int) -> None:
        """Step towards the accepted values. To be called at each timer tick, in the node's thread."""
        if self._tuning.advance(now_ns):
            self._apply(self._tuning.active)
            if not self._tuning.is_changing:
                rospy.loginfo("tuned live: %s", self.changes)

    @property
    def changes(self) -> str:
        """Return the tuned values, for a report."""
        return self._tuning.changes or "nothing"

    def _config(self):
        """Return the accepted values as a message."""
        config = encode_config(self._tuning.accepted)
        config.groups = [GroupState("Default", True, 0, 0)]  # in which all parameters are
        return config

    def _on_reconfigure(self, request):
        """Pass a request to the node's thread and return the accepted values. Called in a thread of ROS."""
        config = request.config
        wanted = {each.name: each.value for each in (*config.bools, *config.ints, *config.strs, *config.doubles)}
        with self._one_request:
            with suppress(NoAnswer):
                self._inbox.ask(self._on_request, wanted, ANSWER_WITHIN_S)
                self._set_parameters()
            accepted = self._config()
            self._updates.publish(accepted)
            return ReconfigureResponse(accepted)

    def _set_parameters(self):
        """Set the tuned values on the parameter server, for a restart of the node."""
        self._has_set_parameters |= bool(self._tuning.changes)
        if self._has_set_parameters:
            with suppress(OSError):  # the master is gone
                for name, value in self._parameters(self._tuning.accepted).items():
                    self._inbox.graph.set_parameter(self._inbox.own_name(f"~{name}"), value)

    def _on_request(self, wanted, done):
        problem = self._tuning.request(wanted, self._inbox.clocks.now_ns())
        done.set_result(None)
        if problem:
            self._warnings.warn("live tuning", problem)

    def _on_save(self, _request):
        """Save the accepted values, once they are active. Called in a thread of ROS."""
        with self._one_save:
            self._inbox.clocks.wait_for(lambda: not self._tuning.is_changing, SETTLE_WITHIN_S, 0.01)
            success, message = _save(self._settings, self._parameters(self._tuning.accepted))
        (rospy.loginfo if success else rospy.logwarn)("save: %s", message)
        return TriggerResponse(success=success, message=message)


class TunedNode:
    """Another node's tunable values, as rqt_reconfigure sees and changes them.

    Attributes:
        namespace: of dynamic_reconfigure's parameters.
        values, low, high: by name; empty until the other node has sent them.
    """

    def __init__(self, inbox: Inbox, namespace: str):
        self.namespace = namespace
        self.values: dict[str, int] = {}
        self.low: dict[str, int] = {}
        self.high: dict[str, int] = {}
        subscribe(f"{namespace}/parameter_descriptions", ConfigDescription, inbox, self._on_description, wakes=False)
        subscribe(f"{namespace}/parameter_updates", Config, inbox, self._on_values, wakes=False)

    def _on_description(self, description, now_ns):
        self.low, self.high = _integers(description.min), _integers(description.max)

    def _on_values(self, config, now_ns):
        self.values = _integers(config)


def _integers(config):
    return {parameter.name: parameter.value for parameter in config.ints}


def request_values(inbox: Inbox, namespace: str, values: Mapping[str, int],
                   on_done: Callable[[Mapping[str, int] | None, str], None]) -> None:
    """Have another node tune its values, as rqt_reconfigure does.

    ``on_done(accepted values or None, problem)`` is called in another thread.
    """
    inbox.graph.call(inbox.resolve_name(f"{namespace}/set_parameters"), Reconfigure,
                     ReconfigureRequest(encode_config(values)),
                     lambda answer, problem: on_done(None if answer is None else _integers(answer.config), problem))


def _save(settings, values):
    """Return whether it succeeded, and a line about it."""
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
