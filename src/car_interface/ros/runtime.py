"""The life of a node: start, loop, shut down.

A node class takes ``Params`` and an ``Inbox`` in its ``__init__``. One thread calls ``step(now_ns)`` whenever something
has arrived or is due; ``step`` returns when it wants to be called next. Callbacks of ROS only put messages into the
inbox. ``shut_down`` is called last, while topics still work.

That thread is the process's main one, or one of several in ``car_nodes``. A node class needn't know which: it makes its
topics and services by the functions of ``topics``, which resolve their names by the inbox.

While another node of its name runs, a node waits before it registers. A node that refuses its parameters ends with one
line; where roslaunch would start it again every 2.5 s, it stays registered instead, says on /diagnostics what it
refuses, and reads its parameters again. roslaunch doesn't tell a node that it is respawned, so the launch files of this
package set RESPAWN_VARIABLE wherever they have respawn="true".

A node that stood still, since its process was frozen or its thread held up, drops what was sent to it meanwhile, and
its inputs are stale. A node class whose attribute ``notices_standstill`` is true sees to that by itself.
"""
from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import threading
import traceback
from contextlib import suppress
from typing import Any, Callable, Mapping

import rospy
from rospy.impl.paramserver import get_param_server_cache

from car_interface.common import causes
from car_interface.common.errors import CarInterfaceError, ConfigError, EndedEarly
from car_interface.common.fixed_parameters import fixed_parameters
from car_interface.common.params import Params
from car_interface.common.process_setup import describe_shortage
from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.ros.diagnostics import ERROR, OK, Diagnostics
from car_interface.ros.inbox import MAX_WAIT_NS, Inbox
from car_interface.ros.logs import LogStream, LogThreads, keep_tracebacks_from_terminal
from car_interface.ros.tcpros_limits import limit_connections
from car_interface.ros.topics import send_directly
from car_interface.ros.wait_for_name import own_name, wait_for_name

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ROSOUT_PARAMETER = "/rosout_disable_topics_generation"  # of rospy's log handler
SHUT_DOWN_S = 2.0
LAST_MESSAGE_S = 0.02  # for rospy to send what a socket did not take at once
FLUSH_S = 0.5  # for the log lines of the shutdown
RESPAWN_VARIABLE = "CAR_INTERFACE_RESPAWN"
FIRST_PAUSE_S, MAX_PAUSE_S = 1, 30  # before refused parameters are read again
REFUSAL_LOG_PERIOD_NS = 300 * NS_PER_S
# The timeout of the arbiters' inputs (``human_timeout`` and the others): after so long each input is stale anyway, so
# that a computer which is only busy stops no car that its timeouts wouldn't stop. Less makes an input look younger by
# less than its timeout.
STANDSTILL_NS = 500 * NS_PER_MS
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
    # A collection then visits only what is newer than the imported modules: about a tenth. turn_arb made three in 90 s
    # at 100 Hz, of 1.2 ms at most.
    gc.collect()
    gc.freeze()
    code = 1
    try:
        spin(node_class, inbox, lambda: fixed_parameters(name, sys.argv[1:]))
        code = 0
    except EndedEarly as error:
        rospy.logwarn("%s", error)
    except Exception as error:
        rospy.logfatal("%s", describe_error(error))
    ended.set()
    rospy.signal_shutdown("ended")  # returns at once if another thread does that already
    unregistered.wait(SHUT_DOWN_S)
    if not logs.flush(FLUSH_S):
        os._exit(code)  # Python's own exit would wait for the log handler that hangs
    sys.exit(code)


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


def spin(node_class, inbox: Inbox, read_fixed: Callable[[], Mapping[str, str | None]]) -> None:
    """Run a node in this thread: read its parameters, build it, step it until it ends, shut it down.

    Args:
        read_fixed: returns what a launch file gave to this process for the node.
    """
    launched_with = ""

    def build():
        nonlocal launched_with
        params = read_params(inbox, read_fixed())
        before, launched_with = launched_with, params.launched_with()
        if launched_with != before:  # refused parameters are read again and again
            rospy.loginfo("launched with %s", launched_with)
        return node_class(params, inbox)
    node = build_node(build, inbox)
    if node is None:
        return
    try:
        steps = Steps(node, inbox)
        while not inbox.ending:
            inbox.wait_until(steps.step())
    finally:
        try:
            node.shut_down()
        finally:
            inbox.clocks.sleep(LAST_MESSAGE_S)


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


class Steps:
    """Steps a node, and has it begin anew after it stood still: its next step began much later than it was due."""

    def __init__(self, node, inbox: Inbox):
        self._node = node
        self._inbox = inbox
        self._due_ns = inbox.clocks.now_ns()
        self._notices_standstill = getattr(node, "notices_standstill", False)

    def step(self) -> float:
        """Step the node once; return when the next step is due if nothing arrives before, ns."""
        inbox, began_ns = self._inbox, self._inbox.clocks.now_ns()
        late_ns = began_ns - self._due_ns
        if late_ns >= STANDSTILL_NS and inbox.subscriptions and not self._notices_standstill:
            rospy.logwarn("%s; what is sent from now on counts", inbox.begin_anew(began_ns, late_ns))
        due_ns = self._node.step(began_ns)
        ended_ns = inbox.clocks.now_ns()
        lasted_too_long = ended_ns - began_ns >= STANDSTILL_NS
        self._due_ns = began_ns if lasted_too_long else max(ended_ns, min(due_ns, ended_ns + MAX_WAIT_NS))
        return due_ns


def describe_error(error: Exception) -> str:
    """Return one line about the error that ended a node. The traceback of a programming error goes to the log file."""
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


def build_node(build: Callable[[], Any], inbox: Inbox) -> Any:
    """Build a node; under respawn as soon as its parameters are accepted. ``None`` = it was ended before.

    Args:
        build: reads the parameters and builds the node. It has touched nothing else when it raises a ConfigError.

    Raises:
        ConfigError: a parameter is refused, and nobody would start the node again.
    """
    refused = None
    while not inbox.ending:
        try:
            node = build()
        except ConfigError as error:
            if not is_respawned():
                raise
            refused = refused or _RefusedStart(inbox)
            refused.wait(error)
        except OSError:
            if refused is None:
                raise
            refused.wait(refused.error)  # the master, which has the parameters, is gone
        else:
            if refused is not None:
                refused.report_acceptance()
            return node
    return None


def is_respawned() -> bool:
    """Return whether whoever started this process starts it again when it ends."""
    return os.environ.get(RESPAWN_VARIABLE, "").lower() in ("1", "true")


class _RefusedStart:
    """The refusals of one start: pauses that double from 1 s to 30 s, and a line when the reason changes.

    The line comes again every five minutes, for those who look at a terminal on which other lines followed.
    """

    def __init__(self, inbox):
        self._inbox = inbox
        self.error = None  # None: the parameters were accepted
        self._pause_s, self._log_ns = FIRST_PAUSE_S, 0
        self._diagnostics = Diagnostics(inbox, "none", {"parameters": self._report}, inbox.clocks.now_ns())

    def wait(self, error):
        """Log and report an error until the parameters are to be read again, or the node is ended.

        A new reason means that somebody is repairing them: the pauses begin anew.
        """
        now_ns, is_new = self._inbox.clocks.now_ns(), str(error) != str(self.error)
        self.error = error
        self._pause_s = FIRST_PAUSE_S if is_new else min(2 * self._pause_s, MAX_PAUSE_S)
        if is_new or now_ns >= self._log_ns:
            self._log_ns = now_ns + REFUSAL_LOG_PERIOD_NS
            later = f", later every {MAX_PAUSE_S} s" if self._pause_s < MAX_PAUSE_S else ""
            rospy.logfatal("%s. This node waits, and reads its parameters again in %s s%s", error, self._pause_s, later)
        due_ns = now_ns + self._pause_s * NS_PER_S
        while not self._inbox.ending and self._inbox.clocks.now_ns() < due_ns:
            self._inbox.wait_until(min(due_ns, self._diagnostics.due_ns))
            self._diagnostics.step(self._inbox.clocks.now_ns())

    def report_acceptance(self):
        self.error = None
        rospy.loginfo("the parameters are accepted now")
        self._diagnostics.force()

    def _report(self, status):
        if self.error is None:
            status.summary(OK, "accepted")
            return
        status.summary(ERROR, f"this node doesn't run, as it refuses a parameter: {self.error}")
        status.add("cause", causes.PARAMETER_REFUSED)
        status.add("parameter", self.error.name)
