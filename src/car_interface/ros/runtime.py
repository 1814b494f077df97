"""The life of a node: start, loop, shut down.

A node class takes ``Params`` and an ``Inbox`` in its ``__init__``. One thread calls ``step(now_ns)`` whenever something
has arrived or is due; ``step`` returns when it wants to be called next. Callbacks of ROS only put messages into the
inbox. ``shut_down`` is called last, while topics still work.

That thread is the process's main one, or one of several in ``car_nodes``. A node class needn't know which: it makes its
topics and services by the functions of ``topics``, which resolve their names by the inbox.

While another node of its name runs, a node waits before it registers. Where roslaunch would start it again, it also
waits while its parameters are refused.

A node that stood still, since its process was frozen or its thread held up, drops what was sent to it meanwhile, and
its inputs are stale. A node class whose attribute ``notices_standstill`` is true sees to that by itself.
"""
from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import traceback
from contextlib import suppress
from typing import Callable, Mapping

import rospy
from rospy.impl.paramserver import get_param_server_cache

from car_interface.common.errors import CarInterfaceError, EndedEarly
from car_interface.common.fixed_parameters import fixed_parameters
from car_interface.common.memory_limit import describe_shortage
from car_interface.common.params import Params
from car_interface.common.standstill import StandstillWatch
from car_interface.ros.direct_connection import send_directly
from car_interface.ros.garbage import IdleCollector, node_activity
from car_interface.ros.inbox import Inbox
from car_interface.ros.logs import LogStream, LogThreads, keep_tracebacks_from_terminal
from car_interface.ros.name_lookup import own_name, wait_for_name
from car_interface.ros.refused_start import build_node
from car_interface.ros.tcpros_limits import limit_connections

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ROSOUT_PARAMETER = "/rosout_disable_topics_generation"  # of rospy's log handler
SHUT_DOWN_S = 2.0
FLUSH_S = 0.5  # for the log lines of the shutdown
SWITCH_INTERVAL_S = 0.0005  # how long one thread may delay the others; Python's default of 5 ms adds to the latency


def run(name: str, node_class) -> None:
    """Run a node as this process: start it, step it until it ends, shut it down.

    Exits with code 1 and one line on a bad parameter, and when a required device can't be used.
    """
    sys.stdout, sys.stderr = LogStream(sys.stdout), LogStream(sys.stderr)
    logging.raiseExceptions = False  # a full disk must not end the node
    keep_tracebacks_from_terminal()
    send_directly()
    without_limits = limit_connections()
    _register(name)
    if without_limits:
        rospy.logwarn("%s", without_limits)
    _keep_rosout_parameter()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    logs = LogThreads()
    inbox = Inbox()
    ended = threading.Event()
    _on_end_signals(inbox.end)
    rospy.on_shutdown(lambda: _end_and_wait(inbox, ended))
    unregistered = threading.Event()
    rospy.core.add_shutdown_hook(lambda reason: unregistered.set())  # called after rospy's own hooks
    failed = False
    try:
        spin(node_class, inbox, IdleCollector(), lambda: fixed_parameters(name, sys.argv[1:]))
    except EndedEarly as error:
        rospy.logwarn("%s", error)
        failed = True
    except Exception as error:
        rospy.logfatal("%s", describe_error(error))
        failed = True
    ended.set()
    rospy.signal_shutdown("ended")  # returns at once if another thread does that already
    unregistered.wait(SHUT_DOWN_S)
    if not logs.flush(FLUSH_S):
        os._exit(1 if failed else 0)  # Python's own exit would wait for the log handler that hangs
    sys.exit(1 if failed else 0)


def _register(name):
    """Register with the master, once no other node has the name; end silently on a signal until then."""
    _on_end_signals(sys.exit)
    claim = wait_for_name(own_name(name, sys.argv))
    _on_end_signals(lambda: sys.exit(1))
    with claim:
        try:
            rospy.init_node(name, disable_signals=True)
        except rospy.ROSInitException:  # a node of the name on another computer has registered a little later
            sys.exit(0)


def _keep_rosout_parameter():
    """Have rospy know the parameter that it looks up for each log line.

    While that isn't set, rospy subscribes to it with each line, which registers this node's name at the master once
    more: a node that wakes after another one has replaced it would end that one by its first line.
    """
    with suppress(Exception):  # the master has gone; or another rospy: these are its internals
        get_param_server_cache().set(ROSOUT_PARAMETER, rospy.get_param(ROSOUT_PARAMETER, False))


def _on_end_signals(act):
    for number in END_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, lambda *_: act())


def spin(node_class, inbox: Inbox, collector: IdleCollector | None = None,
         read_fixed: Callable[[], Mapping[str, str | None]] = dict) -> None:
    """Run a node in this thread: read its parameters, build it, step it until it ends, shut it down.

    Args:
        collector: what collects garbage whenever the node is idle; ``None`` = another thread does, and sees when this
            one is.
        read_fixed: returns what a launch file gave to this process for the node.
    """
    def build():
        fixed = read_fixed()
        return node_class(read_params(inbox, fixed), inbox)
    node = build_node(build, inbox)
    if node is None:
        return
    try:
        if collector is not None:
            _run_steps(node, inbox, collector)
        else:
            with node_activity() as activity:
                _run_steps(node, inbox, activity)
    finally:
        node.shut_down()


def read_params(inbox: Inbox, fixed: Mapping[str, str | None]) -> Params:
    """Return a node's parameters, with those of the namespaces around it and what was given to its process."""
    name, parameter = inbox.node_name, inbox.graph.parameter

    def search_parents(wanted):
        """Return the value in the nearest namespace; None if none has it."""
        namespace, value = name, None
        while namespace and value is None:
            namespace = namespace.rpartition("/")[0]
            value = parameter(f"{namespace}/{wanted}", None)
        return value
    return Params(parameter(name, {}), search_parents, fixed)


def _run_steps(node, inbox, garbage):
    """Step a node until it ends; ``garbage`` learns when it is idle."""
    steps = Steps(node, inbox)
    while not inbox.ending:
        garbage.begin_step()
        due_ns = steps.step()
        inbox.wait_until(min(due_ns, garbage.end_step(steps.ended_ns, due_ns if inbox.is_empty else steps.ended_ns)))


class Steps:
    """Steps a node, and has it begin anew after it stood still.

    Attributes:
        ended_ns: when the last step ended.
    """

    def __init__(self, node, inbox: Inbox):
        self._node = node
        self._inbox = inbox
        self.ended_ns = inbox.clocks.now_ns()
        self._standstill = StandstillWatch(self.ended_ns)
        self._notices_standstill = getattr(node, "notices_standstill", False)

    def step(self) -> float:
        """Step the node once; return when the next step is due if nothing arrives before, ns."""
        inbox, now_ns = self._inbox, self._inbox.clocks.now_ns()
        still_ns = self._standstill.begin_step(now_ns)
        if still_ns and inbox.backlogs and not self._notices_standstill:
            inbox.begin_anew(now_ns, still_ns)
            rospy.logwarn("%s; what is sent from now on counts", inbox.standstill_text)
        due_ns = self._node.step(now_ns)
        self.ended_ns = inbox.clocks.now_ns()
        self._standstill.end_step(self.ended_ns, due_ns)
        return due_ns


def describe_error(error: Exception) -> str:
    """One line about the error that ended a node. The traceback of a programming error goes to the log file."""
    if isinstance(error, CarInterfaceError):
        return str(error)
    logging.getLogger("car_interface").error("%s", traceback.format_exc())  # ROS: to the log file only
    shortage = describe_shortage(error)
    if shortage is not None:
        return shortage
    return f"a fault in this node itself (see its log file): {type(error).__name__}: {error}"


def _end_and_wait(inbox, ended):
    """ROS ends this node (``rosnode kill``): topics work until this returns, so wait for the node's thread."""
    inbox.end()
    if threading.current_thread() is not threading.main_thread():
        ended.wait(SHUT_DOWN_S)
