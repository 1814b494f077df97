"""What a node lets its owner tune while it drives: sliders of dynamic_reconfigure, and ~save, which keeps them.

Requests arrive in a thread of ROS's, which passes them to the node's and waits for its answer: that one alone decides
what is in force.

Services:
    ~set_parameters (dynamic_reconfigure/Reconfigure), below ``namespace``: with the topics parameter_descriptions and
        parameter_updates what rqt_reconfigure works with.
    ~save: see ``save_service``. The file is that of ~save_to.
"""
from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Callable, Mapping

import rospy
from dynamic_reconfigure.server import Server

from car_interface.common.live_parameters import Tuning
from car_interface.common.yaml_edit import Values
from car_interface.ros.inbox import TOO_BUSY, Inbox
from car_interface.ros.save_service import File, serve_saving
from car_interface.ros.throttled_warnings import ThrottledWarnings

ANSWER_WITHIN_S = 2.0
SETTLE_WITHIN_S = 5.0
FOLLOWER = "pca9685/save"  # the servo board's node, whose timeout values follow what is tuned


class _Server(Server):
    """The library's, but for what would happen behind the node's back."""

    def _clamp(self, config):
        """What lies beyond a limit comes to the callback, which clamps it and says so."""

    def _copy_to_parameter_server(self):
        """Parameters that nobody tuned stay where they are: turn_arb's may be those of a namespace around it."""

    def _set_callback(self, req):
        req.config.groups = []  # there is only one; the library fails on those that it doesn't know
        return super()._set_callback(req)


class _Request:
    """The values that somebody asks for, and the answer once there is one."""

    def __init__(self, wanted):
        self.wanted = wanted
        self.answered = threading.Event()
        self.was_dropped = False

    def drop(self):
        self.was_dropped = True
        self.answered.set()


class ReconfigureServer:
    """A node's tunable values.

    Args:
        inbox: the node's.
        warnings: the node's; what of a request isn't accepted is counted there.
        tuning: the values, their limits, and how fast they move.
        apply: puts values in force; called in the node's thread.
        parameters: all parameters that belong to such values, with the names that they have in the node's namespace and
            in its file; called in any thread.
        offered: the class that catkin made of a .cfg file.
        save_to: the file; ``None`` = nowhere.
        namespace: below the node's, where dynamic_reconfigure keeps the parameters.
    """

    def __init__(self, inbox: Inbox, warnings: ThrottledWarnings, tuning: Tuning,
                 apply: Callable[[Mapping[str, int]], None], parameters: Callable[[Mapping[str, int]], Values],
                 offered, save_to: str | None, namespace: str = ""):
        self._inbox = inbox
        self._warnings = warnings
        self._tuning = tuning
        self._apply = apply
        self._parameters = parameters
        self._save_to = save_to
        self._serving = False
        self._kept = False  # whether the parameter server has tuned values
        apply(tuning.in_force)
        own = f"{inbox.node_name}/{namespace}" if namespace else inbox.node_name
        self._server = _Server(_limited(offered, tuning), self._on_reconfigure, own)
        for take_back in (self._server.set_service.shutdown, self._server.descr_topic.unregister,
                          self._server.update_topic.unregister):
            inbox.on_close(take_back)
        self._serving = True
        serve_saving(inbox, self._files, FOLLOWER)

    def step(self, now_ns: int) -> None:
        """Go on towards what was accepted. On every heartbeat, in the node's thread."""
        if self._tuning.advance(now_ns):
            self._apply(self._tuning.in_force)
            if not self._tuning.moving:
                rospy.loginfo("tuned live: %s", self.changes)

    @property
    def changes(self) -> str:
        """What was tuned, for a report."""
        return self._tuning.changes or "nothing"

    def _on_reconfigure(self, config, level):
        """Pass a request on, wait for the answer, return what is accepted by now. In a thread of ROS's."""
        if self._serving:
            request = _Request({name: config.get(name) for name in self._tuning.accepted})
            self._inbox.put(self._on_request, request, on_drop=request.drop)
            answered = request.answered.wait(ANSWER_WITHIN_S)
            if request.was_dropped:
                raise rospy.ServiceException(TOO_BUSY)
            if answered:
                self._keep_for_a_restart()
        else:
            self._groups = config["groups"]  # as the .cfg file has them
        return type(config)({**self._tuning.accepted, "groups": self._groups})

    def _keep_for_a_restart(self):
        """A node that is started again finds the parameters as they belong together."""
        if self._tuning.changes:
            self._kept = True
        if self._kept:
            try:
                for name, value in self._parameters(self._tuning.accepted).items():
                    rospy.set_param(self._inbox.resolve_name(f"~{name}"), value)
            except OSError:
                pass  # without a master nothing is started again either

    def _on_request(self, request, now_ns):
        answer = self._tuning.request(request.wanted, now_ns)
        request.answered.set()
        if answer.problem:
            self._warnings.warn("live tuning", answer.problem)

    def _files(self):
        """What ~save shall save: what was accepted, once it is in force."""
        deadline_s = time.monotonic() + SETTLE_WITHIN_S
        while self._tuning.moving and time.monotonic() < deadline_s:
            time.sleep(0.01)
        return [File("save_to", self._save_to, self._parameters(self._tuning.accepted))]


def _limited(offered, tuning):
    """The class of a .cfg file, with the limits of this car and its values for defaults."""
    parameters = [{**parameter, "min": tuning.low[parameter["name"]], "max": tuning.high[parameter["name"]],
                   "default": tuning.accepted[parameter["name"]]}
                  for parameter in offered.config_description["parameters"]]
    return SimpleNamespace(min=dict(tuning.low), max=dict(tuning.high), defaults=dict(tuning.accepted),
                           level=offered.level,
                           config_description={**offered.config_description, "parameters": parameters})

