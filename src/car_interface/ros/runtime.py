"""The life of a node: start, loop, shut down.

A node class takes ``Params`` and an ``Inbox`` in its ``__init__``. One thread calls ``step(now_ns)`` whenever something
has arrived or is due; ``step`` returns when it wants to be called next. Callbacks of ROS only put messages into the
inbox. ``shut_down`` is called last, while topics still work.

That thread is the process's main one, or one of several in ``car_nodes``. A node class needn't know which: it makes its
topics and services by the functions of ``topics``, which resolve their names by the inbox.

While another node of its name runs, a node waits before it registers. Where roslaunch would start it again, it also
waits while its parameters are refused.
"""
from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
import traceback

import rospy

from car_interface.common.errors import CarInterfaceError
from car_interface.common.params import Params
from car_interface.ros.garbage import IdleCollector
from car_interface.ros.inbox import Inbox
from car_interface.ros.logs import LogStream, LogThreads
from car_interface.ros.name_lookup import own_name, wait_for_name
from car_interface.ros.refused_start import build_node

END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SHUT_DOWN_S = 2.0
FLUSH_S = 0.5  # for the log lines of the shutdown
SWITCH_INTERVAL_S = 0.0005  # how long one thread may delay the others; Python's default of 5 ms adds to the latency


def run(name: str, node_class) -> None:
    """Run a node as this process: start it, step it until it ends, shut it down.

    Exits with code 1 and one line on a bad parameter, and when a required device can't be used.
    """
    sys.stdout, sys.stderr = LogStream(sys.stdout), LogStream(sys.stderr)
    logging.raiseExceptions = False  # a full disk must not end the node
    _register(name)
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
        spin(node_class, inbox, IdleCollector())
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


def _on_end_signals(act):
    for number in END_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, lambda *_: act())


def spin(node_class, inbox: Inbox, collector: IdleCollector | None = None) -> None:
    """Run a node in this thread: read its parameters, build it, step it until it ends, shut it down.

    Args:
        collector: what collects garbage whenever the node is idle; ``None`` = another thread has that.
    """
    name = inbox.node_name

    def build():
        return node_class(Params(rospy.get_param(name, {}), lambda wanted: _search_parents(name, wanted)), inbox)
    node = build_node(build, inbox)
    if node is None:
        return
    try:
        while not inbox.ending:
            due_ns = node.step(time.monotonic_ns())
            if collector is not None and inbox.is_empty:
                collector.step(time.monotonic_ns(), due_ns)
            inbox.wait_until(due_ns)
    finally:
        node.shut_down()


def describe_error(error: Exception) -> str:
    """One line about the error that ended a node. The traceback of a programming error goes to the log file."""
    if isinstance(error, CarInterfaceError):
        return str(error)
    logging.getLogger("car_interface").error("%s", traceback.format_exc())  # ROS: to the log file only
    return f"a fault in this node itself (see its log file): {type(error).__name__}: {error}"


def _end_and_wait(inbox, ended):
    """ROS ends this node (``rosnode kill``): topics work until this returns, so wait for the node's thread."""
    inbox.end()
    if threading.current_thread() is not threading.main_thread():
        ended.wait(SHUT_DOWN_S)


def _search_parents(node_name, name):
    """A parameter's value from the nearest namespace around a node; None if none has it."""
    namespace = node_name
    while namespace:
        namespace = namespace.rpartition("/")[0]
        value = rospy.get_param(f"{namespace}/{name}", None)
        if value is not None:
            return value
    return None
