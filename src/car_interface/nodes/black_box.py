"""The black_box node: keeps the car's messages of the last 60 s in memory, and writes them into a bag when the car was
stopped and nobody asked for that.

It only listens: nothing depends on it, and it runs with a lower priority than the car's own nodes. The bag is written
5 s after the stop, at most one in 30 s; a stop that comes in between is in the memory of the next bag.

Subscribes:
    TOPICS, whatever their types are. Cameras and point clouds aren't among them.
Publishes:
    /diagnostics (diagnostic_msgs/DiagnosticArray, 1 Hz): what it holds, and the newest bag.
"""
from __future__ import annotations

import io
import math
import os
from collections import Counter, deque
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any, Mapping, NamedTuple

import genpy
import rospy

from car_interface.common import causes
from car_interface.common.black_box_folder import TIME_FORMAT, BlackBoxConfig, default_folder, newest, store
from car_interface.common.declared import read_all
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import PLANNER, TELEOP
from car_interface.common.units import NS_PER_S
from car_interface.msg import SteeringState, TeleopState, ThrottleState
from car_interface.nodes.bag_recording import DECISIONS, PLANNERS
from car_interface.ros.diagnostics import OK, WARN, Diagnostics
from car_interface.ros.runtime import describe_error, run
from car_interface.ros.topics import subscribe

# Each message costs its sender's time, too, so what others repeat is left out: the servo board's commands and the
# requests of teleop_logi are in the states of the arbiters and in joy, the Teensy's raw counts in odom and the ranges.
# With those the demo's car sends 660 messages a second instead of 330, and this node took 4.1 % of a core instead of
# 1.9 (AMD EPYC, Python 3.11).
TOPICS = (*DECISIONS, *PLANNERS)
QUEUE = 1000  # messages of a topic that wait while this process doesn't get a CPU: some seconds of the fastest
AFTER_NS = 5 * NS_PER_S  # how it ended: a car that slides, or is stopped by hand
PAUSE_NS = 30 * NS_PER_S  # between two bags: they would have most in common
CLOCK_SET_NS = NS_PER_S // 2
NICENESS = 5
WRITTEN_WITHIN_S, POLL_S = 10.0, 0.02  # at the node's end; roslaunch kills after 15 s
SPAN_NS = 60 * NS_PER_S
MAX_BYTES = 20_000_000
# Of a message in memory beside its bytes: the tuple, the time and the header of the bytes object (sys.getsizeof, 64-bit
# Python 3.11: 64, 32 and 33).
OVERHEAD_BYTES = 130
# What is larger is no state or command: the largest of a car's own are /diagnostics with some 4 kB.
MAX_MESSAGE_BYTES = 16_384
# A topic that floods must not push the others out. An IMU at 200 Hz passes.
MAX_PER_S = 300
TURN_ARB, THROTTLE_ARB, TELEOP_LOGI = "turn_arb", "throttle_arb", "teleop_logi"
STANDSTILL_MPS = 0.05  # one pulse of a wheel, 15 mm, in 0.3 s
MIN_THROTTLE = 0.01
TICK_HZ = 10
# A car counts as driven for so long after it moved or had throttle: more than its stop at a time-out of 0.5 s lasts.
DRIVEN_TICKS = 2 * TICK_HZ
SILENT_TICKS = TICK_HZ  # of an arbiter that sends its state at 10 Hz or more: it has crashed or hangs


class Message(NamedTuple):
    """A serialized message, and where it came from."""

    at_ns: int  # of the monotonic clock, at its arrival
    topic: str
    header: Mapping[str, str]  # of its connection: type, md5sum, message_definition, callerid, latching
    data: bytes


class Ring:
    """Keeps the messages of the last 60 s, and of each latched topic the last one before those.

    Attributes:
        size_bytes: what it holds, with Python's overhead.
        dropped: how many messages were too large, or more than their topic may send.
    """

    def __init__(self, max_bytes: int = MAX_BYTES):
        self.size_bytes = self.dropped = 0
        self._max_bytes = max_bytes
        self._messages: deque[Message] = deque()
        self._latched: dict[tuple[str, str], Message] = {}  # the newest, by topic and sender
        self._second, self._counts = 0, Counter()  # of the messages by topic in the second of the monotonic clock

    def add(self, message: Message) -> None:
        """Keep a message, and let go what is too old or too much."""
        second = message.at_ns // NS_PER_S
        if second != self._second:
            self._second, self._counts = second, Counter()
        self._counts[message.topic] += 1
        if len(message.data) > MAX_MESSAGE_BYTES or self._counts[message.topic] > MAX_PER_S:
            self.dropped += 1
            return
        self._messages.append(message)
        self.size_bytes += len(message.data) + OVERHEAD_BYTES
        if message.header.get("latching") == "1":
            self._latched[message.topic, message.header.get("callerid", "")] = message
        while self.size_bytes > self._max_bytes or self._messages[0].at_ns < message.at_ns - SPAN_NS:
            self.size_bytes -= len(self._messages.popleft().data) + OVERHEAD_BYTES

    def messages(self) -> list[Message]:
        """Return all of it, oldest first; a latched message that is older than the rest has the time of the oldest."""
        first_ns = self._messages[0].at_ns if self._messages else 0
        return [message._replace(at_ns=first_ns) for message in self._latched.values()
                if message.at_ns < first_ns] + list(self._messages)


class Stop(NamedTuple):
    cause: str  # one of causes.LOSSES, or which node is silent
    reason: str


class StopWatch:
    """Recognizes a stop that nobody asked for: the car was driven, and what drove it was lost.

    It goes by the states of turn_arb, throttle_arb and teleop_logi. A person who releases the deadman or presses the
    e-stop asks for the stop, and so does a planner that has stopped the car before it falls silent. ``tick`` is called
    TICK_HZ times a second; a pause of the caller's counts as one tick.

    A state makes a stop if its node had given the car to somebody by the state before, and now names a loss.
    """

    def __init__(self):
        self._driven_ticks = 0  # for how long the car still counts as driven
        self._has_throttle_arb = False
        self._quiet_ticks: dict[str, int] = {}  # since the newest state, of the nodes by which somebody has the car

    def on_steering(self, state: Any) -> Stop | None:
        """Take a car_interface/SteeringState."""
        speed_mps = state.speed if state.odometry_age < 1.0 else math.nan
        # Without throttle_arb and without odometry nobody knows whether it moves.
        if abs(speed_mps) > STANDSTILL_MPS or not self._has_throttle_arb and math.isnan(speed_mps):
            self._driven_ticks = DRIVEN_TICKS
        return self._update(TURN_ARB, state.source in (TELEOP, PLANNER), state.cause, state.reason)

    def on_throttle(self, state: Any) -> Stop | None:
        """Take a car_interface/ThrottleState."""
        self._has_throttle_arb = True
        if abs(state.granted) > MIN_THROTTLE or abs(state.speed) > STANDSTILL_MPS:
            self._driven_ticks = DRIVEN_TICKS
        if state.esc_cause == causes.ESC_MOTION:
            return self._update(THROTTLE_ARB, False, state.esc_cause, state.esc_reason)
        return self._update(THROTTLE_ARB, state.source in (TELEOP, PLANNER), state.cause, state.reason)

    def on_gamepad(self, state: Any) -> Stop | None:
        """Take a car_interface/TeleopState: why a deadman is false that no hand has released."""
        return self._update(TELEOP_LOGI, state.human_in_loop, state.cause, state.reason)

    def tick(self) -> Stop | None:
        """Count the time; return a stop for an arbiter whose states have ended."""
        silent = [node for node, ticks in self._quiet_ticks.items()
                  if ticks == SILENT_TICKS and node != TELEOP_LOGI]  # whose silence the arbiters report sooner
        self._quiet_ticks = {node: ticks + 1 for node, ticks in self._quiet_ticks.items() if ticks < SILENT_TICKS}
        was_driven, self._driven_ticks = self._driven_ticks > 0, max(0, self._driven_ticks - 1)
        return Stop(f"{silent[0]} silent", "its states have ended") if silent and was_driven else None

    def _update(self, node, has_car, cause, reason):
        had_car = self._quiet_ticks.pop(node, None) is not None
        if has_car:
            self._quiet_ticks[node] = 0
        elif had_car and self._driven_ticks and cause in causes.LOSSES:
            return Stop(cause, reason)
        return None


class BlackBox:
    """Keeps the newest messages, and writes them after a stop that nobody asked for."""

    notices_standstill = True  # what was sent while it stood still is to be recorded, too

    def __init__(self, params, inbox):
        self._folder = read_all(params, BlackBoxConfig).folder or default_folder()
        self._inbox = inbox
        self._ring, self._watch = Ring(), StopWatch()
        self._due: tuple[int, Stop, str] | None = None  # when to write, and the stop with the time of day
        self._next_ns = 0  # no stop before it makes a bag
        self._is_writing = False
        self._problem = ""  # why the newest bag couldn't be written
        self._offset_ns, self._clock_set_ns = inbox.clocks.ros_offset_ns()[0], -SPAN_NS
        now_ns = inbox.clocks.now_ns()
        self._timer = RateTimer(TICK_HZ, now_ns)
        self._diagnostics = Diagnostics(inbox, "none", {"black box": self._report}, now_ns)
        states = {"turn_arb/state": (SteeringState, self._watch.on_steering),
                  "throttle_arb/state": (ThrottleState, self._watch.on_throttle),
                  "teleop_logi/state": (TeleopState, self._watch.on_gamepad)}
        for topic in TOPICS:
            subscribe(topic, rospy.AnyMsg, inbox, self._recorder(inbox.resolve_name(topic), *states.get(topic, ())),
                      queue_size=QUEUE, wakes=False)

    def step(self, now_ns):
        """Keep what arrived; write when it is due."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            self._on_stop(self._watch.tick(), now_ns)
            self._watch_clock(now_ns)
        if self._due is not None and now_ns >= self._due[0] and not self._is_writing:
            self._write(now_ns)
        self._diagnostics.step(now_ns)
        return min(self._timer.due_ns, self._diagnostics.due_ns)

    def shut_down(self):
        """Write what is still to be written."""
        if self._due is not None and not self._is_writing:
            self._write(self._inbox.clocks.now_ns())
        self._inbox.clocks.wait_for(self._has_written, WRITTEN_WITHIN_S, POLL_S)

    def _has_written(self):
        self._inbox.dispatch()
        return not self._is_writing

    def _recorder(self, topic, state_type=None, on_state=None):
        """Return the handler of a topic's messages; one of a state also looks for a stop."""
        def record(message, now_ns):
            header = message._connection_header
            self._ring.add(Message(now_ns, topic, header, message._buff))
            if state_type is not None and header.get("md5sum") == state_type._md5sum:
                with suppress(genpy.DeserializationError):
                    self._on_stop(on_state(state_type().deserialize(message._buff)), now_ns)
        return record

    def _on_stop(self, stop, now_ns):
        if stop is not None and now_ns >= self._next_ns:
            self._due = now_ns + AFTER_NS, stop, self._inbox.clocks.local_time(TIME_FORMAT)
            self._next_ns = now_ns + PAUSE_NS

    def _watch_clock(self, now_ns):
        offset_ns, error_ns = self._inbox.clocks.ros_offset_ns()
        if abs(offset_ns - self._offset_ns) > CLOCK_SET_NS + error_ns:
            self._clock_set_ns = now_ns
        self._offset_ns = offset_ns

    def _write(self, now_ns):
        (_, stop, time_text), self._due, self._is_writing = self._due, None, True
        messages, offset_ns = self._ring.messages(), self._offset_ns
        if now_ns - self._clock_set_ns < SPAN_NS:
            rospy.logwarn("the clock of this computer was set within the recording: its times go by the clock as it is "
                          "now, the stamps of older messages don't")

        def write():
            try:
                return store(self._folder, time_text, stop.cause, bag_of(messages, offset_ns)), ""
            except Exception as error:  # a full disk, or a fault: the car drives on
                return "", getattr(error, "strerror", None) or describe_error(error)
        self._inbox.work(write, partial(self._on_written, stop))

    def _on_written(self, stop, written, now_ns):
        self._is_writing = False
        path, self._problem = written
        if self._problem:
            rospy.logerr("the car was stopped by %s (%s), and no recording of it could be written to %s: %s",
                         stop.cause, stop.reason, self._folder, self._problem)
        else:
            rospy.logwarn("the car was stopped by %s (%s): rosrun car_interface bag_report %s", stop.cause,
                          stop.reason, path)
        self._diagnostics.report_now()

    def _report(self, status):
        status.summary(OK, "it keeps the last 60 s before a stop that nobody asked for")
        if self._problem:
            status.summary(WARN, f"the last recording couldn't be written: {self._problem}")
            status.add("remedy", f"Make room, or choose another folder than {self._folder}")
        recording = newest(self._folder)
        status.add("newest recording", recording.path if recording else "none")
        status.add("memory", f"{self._ring.size_bytes / 1e6:.1f} MB")
        status.add("messages left out", self._ring.dropped)


def bag_of(messages: list[Message], offset_ns: int) -> bytes:
    """Return messages as a ROS 1 bag.

    Their times are those of the monotonic clock, shifted by one offset: they rise, whatever was done to ROS time.

    Args:
        messages: oldest first.
        offset_ns: of ROS time to the monotonic clock.
    """
    import rosbag  # here: it takes 5 MB and 0.1 s, and most drives have no such stop
    file = _Buffer()
    # In rosbag's bags a topic has one connection: the newest here. Messages of another type are left out.
    headers = {message.topic: {**message.header, "topic": message.topic} for message in messages}
    with rosbag.Bag(file, "w", compression=rosbag.Compression.BZ2) as bag:
        for message in messages:
            header, md5 = headers[message.topic], message.header["md5sum"]
            if md5 == header["md5sum"]:
                bag.write(message.topic, (header["type"], message.data, md5, SimpleNamespace(_md5sum=md5)),
                          genpy.Time(nsecs=max(1, message.at_ns + offset_ns)), raw=True, connection_header=header)
    return file.content


class _Buffer(io.BytesIO):
    """A file for rosbag, which asks for its mode. Its content remains when rosbag closes it."""

    mode = "w+b"
    content = b""

    def close(self):
        self.content = self.getvalue()
        super().close()


def main():
    with suppress(OSError):
        os.nice(NICENESS)
    run("black_box", BlackBox)
