"""What happened on a drive, from its recording: in one pass, and in memory that doesn't grow with its length."""
from __future__ import annotations

import math
import re
from collections import Counter, deque
from typing import Any, NamedTuple

from car_interface.interlock.motion_interlock import REARM_REASON
from car_interface.recordings.recording import NoRecording, Recorded, absolute_names, contents, other_version, read
from car_interface.report.downsample import Path, Spots, Trace
from car_interface.steering.arbiter import LOCKED, NEUTRAL, NO_HUMAN

NS_PER_S = 1_000_000_000
OK, WARN, ERROR = range(3)  # as in diagnostic_msgs/DiagnosticStatus
LEVELS = ("ok", "warning", "error")
UNKNOWN_DRIVER = -1

# Relative names move below the car's namespace, as do the others where they're found there.
SONARS = tuple(f"sonar/{end}_{side}" for end in ("front", "rear") for side in ("right", "middle", "left"))
TYPES = {
    "turn_arb/state": "car_interface/SteeringState",
    "/servo/output": "std_msgs/Int32MultiArray",
    "av_turnrad_req": "std_msgs/Float32",
    "/teleop_logi/tele_steer_req": "std_msgs/Float32",
    "odom": "nav_msgs/Odometry",
    "control/command/control_cmd": ("car_interface/Control", "autoware_control_msgs/Control"),
    "generic/output/value": ("car_interface/Float64Stamped", "tier4_debug_msgs/Float64Stamped",
                             "autoware_internal_debug_msgs/Float64Stamped"),
    **dict.fromkeys(SONARS, "sensor_msgs/Range"),
    "/tf_static": "tf2_msgs/TFMessage",
    "teensy_sensor_hub/link": "car_interface/LinkStatus",
    "teensy_clock": "car_interface/TeensyClock",
    "teensy_error": "car_interface/Error",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/rosout": ("rosgraph_msgs/Log", "rcl_interfaces/Log"),
}
STEERING_CHANNEL = 0  # as config/turn_arb.yaml has it
NEEDED = ("odom", "turn_arb/state", "/servo/output")  # one of them at least
LOG_LEVELS = {"rosgraph_msgs": (4, 8), "rcl_interfaces": (30, 40)}  # warning and error

WINDOW_S = 0.3  # over which accelerations and curvatures are taken: a dozen reports of the wheels
MIN_DISTANCE_M = 0.05  # in it, for a curvature
MOVING_MPS = 0.05
STEP_M = 1.0  # from one odometry to the next: more is a new beginning, not a way
ODOMETRY_SILENT_S = 0.5  # the hub reports at least every 0.2 s
CLOCK_SET_S = 0.05  # of a change between ROS time and the monotonic clock from one pong to the next
# For how the car turns against what the tables say: at speed, in a real bend, a while after the servo was last moved.
STEADY_S, MIN_CURVATURE, MIN_SPEED_MPS = 0.7, 0.1, 0.3
RATIO_BINS, BINS_PER_UNIT = 300, 100
MAX_REPORTED = 2000  # entries of a list; the rest are counted
# The last one is that of older recordings.
LOSS_SIGNS = (" silent for ", "no number to act on", REARM_REASON, "let go of the deadman")


class Episode(NamedTuple):
    """A while in which the same one steered for the same kind of reason."""

    start_s: float
    end_s: float
    source: int  # a value of SteeringState.source
    reason: str


class Fault(NamedTuple):
    """Something that went wrong, and when."""

    start_s: float
    end_s: float  # NaN: it's a moment, or it didn't end before the recording did
    level: int
    where: str
    what: str
    times: int = 1


class Drive:
    """What happened. Times are seconds since the recording's first message.

    Attributes:
        path, namespace, start_ns, duration_s: of the recording; ``topics`` what it has.
        present: which of the topics that a report is made from were recorded.
        episodes: who drove, and why. ``source_s``: seconds by source.
        faults: in order of time; ``pending`` counts those beyond what is kept, and episodes.
        Traces (a ``Trace`` each): see ``_traces``.
        way: where odometry saw the car; ``hits``: where the sonars saw something.
        turned: (left, right) how tightly the car turned against what was sent: median of the ratio, and samples.
        counters: the Teensy's, by name: first and last value seen.
        link: the newest LinkStatus; ``first_link``.
    """

    def __init__(self, path: str, namespace: str, start_ns: int, end_ns: int, topics: dict):
        self.path, self.namespace, self.start_ns = path, namespace, start_ns
        self.duration_s = (end_ns - start_ns) / NS_PER_S
        self.topics = topics
        self.present: set = set()
        self.episodes: list = []
        self.source_s: Counter = Counter()
        self.faults: list = []
        self.pending = 0
        self.traces = {name: Trace(0.0, self.duration_s) for name in (
            "asked curvature", "sent curvature", "turned curvature", "gamepad", "speed", "acceleration",
            "asked acceleration", "value", "frames", "bad frames", "round trip", "skew", "uncertainty")}
        self.duties: dict = {}  # a trace by channel, for those that were ever driven
        self.steering_channel = None
        self.way, self.hits = Path(), Spots()
        self.nearest_m, self.nearest_s, self.nearest_sonar = math.inf, math.nan, ""
        self.distance_m = self.moving_s = 0.0
        self.turned: tuple = ((math.nan, 0), (math.nan, 0))
        self.counters: dict = {}
        self.link = self.first_link = None
        self.pongs = self.pongs_unused = 0
        self.sonars_without_place: set = set()


def look_at(path: str, namespace: str = "/", odom: str = "odom", progress: bool = False) -> Drive:
    """Go through a recording.

    Args:
        path: of it.
        namespace: the car's.
        odom: the topic of its odometry.
        progress: show a bar on a terminal.

    Raises:
        NoRecording: it can't be read, or has nothing that a report could be made from.
    """
    has = contents(path)
    types = {(odom if name == "odom" else name): kind for name, kind in TYPES.items()}
    heard = {name: topic for name, topic in has.topics.items() if topic.count}
    names = absolute_names(heard, types, namespace)
    below = "/" + "/".join([*filter(None, namespace.split("/")), ""])  # an absolute name may be another car's
    needed = {odom if name == "odom" else name for name in NEEDED}
    if not any(asked in needed and name.startswith(below) for name, asked in names.items()):
        raise NoRecording(f"{path} has no message of {odom}, turn_arb/state or /servo/output"
                          + _elsewhere(heard, namespace))
    drive = Drive(path, namespace, has.start_ns, has.end_ns, has.topics)
    drive.present = {"odom" if name == odom else name for name in names.values()}
    watch = _Watch(drive, {name.lstrip("/"): kind.type for name, kind in has.topics.items()})
    for recorded in read(path, types, namespace, progress):
        try:
            watch.take(recorded, "odom" if recorded.topic == odom else recorded.topic)
        except AttributeError as error:
            raise other_version(path, recorded) from error
    if has.steps_back:
        times = "once" if has.steps_back == 1 else f"{has.steps_back} times"
        watch.fault(0.0, WARN, "recording", f"its time went back {times}: the clock was set")
    watch.finish()
    return drive


def _elsewhere(topics, namespace):
    """A hint at the namespaces that have what was looked for."""
    spaces = {name[:-len(ending)] for name in topics for ending in ("/turn_arb/state", "/servo/output", "/odom")
              if name.endswith(ending)} - {""}
    place = f" below {namespace}" if namespace.strip("/") else ""
    odometry = [name for name, topic in topics.items() if topic.type == "nav_msgs/msg/Odometry"]
    if spaces:
        return f"{place}: try " + " or ".join(f"--ns {space}" for space in sorted(spaces))
    if place and any("/" + name.lstrip("/") in topics for name in NEEDED):
        return f"{place}: try it without --ns"
    if odometry:
        return f"{place}: try --odom {odometry[0]}"
    return f"{place}; it has " + (", ".join(list(topics)[:8]) or "no topic at all")


class _Watch:
    """Takes one message after the other."""

    def __init__(self, drive, types):
        self._drive = drive
        self._trace = drive.traces
        self._log_levels = LOG_LEVELS.get(types.get("rosout", "").split("/")[0], LOG_LEVELS["rosgraph_msgs"])
        self._episode = None
        self._source = UNKNOWN_DRIVER
        self._state_duty = self._sent = None  # what turn_arb sent last: duty and curvature
        self._sent_since_s = 0.0
        self._matches: Counter = Counter()  # by channel: how often the board held turn_arb's duty
        self._recent: deque = deque()  # of odometry, a window long: time, speed, yaw, way
        self._yaw = self._distance_m = 0.0
        self._poses: deque = deque(maxlen=60)  # stamp, x, y, yaw
        self._odometry = None  # time, pose of the newest
        self._ratios = ([0] * RATIO_BINS, [0] * RATIO_BINS)
        self._mounts: dict = {}
        self._open: dict = {}  # faults that last: by who says so
        self._logged: dict = {}  # index of a log line's fault, by who says what
        self._monotonic_ns = None
        self._link_s = 0.0
        self._handlers = {
            "turn_arb/state": self._state, "/servo/output": self._output, "odom": self._odom,
            "av_turnrad_req": self._planner, "/teleop_logi/tele_steer_req": self._gamepad,
            "control/command/control_cmd": self._command, "generic/output/value": self._value,
            "/tf_static": self._static_tf, "teensy_sensor_hub/link": self._link, "teensy_clock": self._clock,
            "teensy_error": self._error, "/diagnostics": self._diagnostics, "/rosout": self._log,
        }

    def take(self, recorded: Recorded, name: str) -> None:
        """Take a message of the topic that is called ``name`` here."""
        time_s = (recorded.time_ns - self._drive.start_ns) / NS_PER_S
        handler = self._handlers.get(name)
        if handler is None:
            self._range(time_s, recorded.message, name)
        else:
            handler(time_s, recorded.message)

    def finish(self) -> None:
        """Close what is still open when the recording ends."""
        drive = self._drive
        if self._episode is not None:
            self._end_episode(drive.duration_s)
        for fault in self._open.values():
            self._keep(fault)
        drive.faults.sort(key=lambda fault: fault.start_s)
        drive.turned = tuple(_median_of(bins) for bins in self._ratios)
        if self._matches:
            drive.steering_channel = self._matches.most_common(1)[0][0]
        elif STEERING_CHANNEL in drive.duties:  # nobody said what was sent
            drive.steering_channel = STEERING_CHANNEL

    def fault(self, time_s, level, where, what) -> None:
        """A fault that is a moment."""
        self._keep(Fault(time_s, math.nan, level, where, what))

    def _keep(self, fault):
        if len(self._drive.faults) < MAX_REPORTED:
            self._drive.faults.append(fault)
        else:
            self._drive.pending += 1

    def _lasting(self, time_s, key, level, where, what):
        """A fault that goes on for as long as it's told; level OK ends it, words of another kind begin another."""
        fault = self._open.get(key)
        if fault is not None and (level == OK or _kind(fault.what) != _kind(what)):
            self._keep(fault._replace(end_s=time_s))
            del self._open[key]
            fault = None
        if level != OK:
            self._open[key] = Fault(time_s, math.nan, level, where, what) if fault is None else \
                fault._replace(level=max(level, fault.level))

    # --- who drove ---

    def _state(self, time_s, message):
        self._source = message.source
        if self._episode is None or (message.source, _kind(message.reason)) != self._episode[1:3]:
            if self._episode is not None:
                self._end_episode(time_s)
            self._episode = (time_s, message.source, _kind(message.reason), message.reason)
        sent = 1 / message.turn_radius if message.turn_radius else math.nan
        self._trace["sent curvature"].add(time_s, sent)
        if message.duty != self._state_duty:
            self._sent_since_s = time_s
        self._state_duty, self._sent = message.duty, sent

    def _end_episode(self, time_s):
        start_s, source, _, reason = self._episode
        drive = self._drive
        drive.source_s[source] += time_s - start_s
        if len(drive.episodes) < MAX_REPORTED:
            drive.episodes.append(Episode(start_s, time_s, source, reason))
        else:
            drive.pending += 1
        if source == LOCKED or source in (NO_HUMAN, NEUTRAL) and is_loss(reason):
            self._keep(Fault(start_s, time_s, ERROR if source == LOCKED else WARN, "turn_arb", reason))

    # --- steering, speed, place ---

    def _output(self, time_s, message):
        if self._state_duty is not None:
            self._matches.update(channel for channel, duty in enumerate(message.data)
                                 if abs(duty - self._state_duty) <= 16)
        duties = self._drive.duties
        for channel, duty in enumerate(message.data):
            if duty > 0 and channel not in duties:
                duties[channel] = Trace(0.0, self._drive.duration_s)
            if channel in duties:
                duties[channel].add(time_s, duty)

    def _planner(self, time_s, message):
        if message.data:  # 0 asks for nothing
            self._trace["asked curvature"].add(time_s, 1 / message.data)

    def _gamepad(self, time_s, message):
        self._trace["gamepad"].add(time_s, message.data)

    def _command(self, time_s, message):
        self._trace["asked acceleration"].add(time_s, message.longitudinal.acceleration)

    def _value(self, time_s, message):
        self._trace["value"].add(time_s, message.data)

    def _odom(self, time_s, message):
        drive, position, turn = self._drive, message.pose.pose.position, message.pose.pose.orientation
        speed = message.twist.twist.linear.x
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y * turn.y + turn.z * turn.z))
        if not all(map(math.isfinite, (position.x, position.y, yaw, speed))):
            return
        stamp_s = _seconds(message.header.stamp, drive.start_ns)
        if self._odometry is not None:
            before_s, x, y, yaw_before = self._odometry
            way = math.hypot(position.x - x, position.y - y)
            if time_s - before_s > ODOMETRY_SILENT_S:
                self._keep(Fault(before_s, time_s, WARN, "odom", f"silent for {time_s - before_s:.2f} s"))
            if way > STEP_M:
                self.fault(time_s, WARN, "odom", f"began anew: {way:.1f} m from where it was")
                self._recent.clear()
                drive.way.interrupt()
            else:
                drive.distance_m += way
                self._distance_m += math.copysign(way, speed)
            self._yaw += math.remainder(yaw - yaw_before, 2 * math.pi)
            if abs(speed) > MOVING_MPS and 0 < time_s - before_s < ODOMETRY_SILENT_S:
                drive.moving_s += time_s - before_s
        self._odometry = (time_s, position.x, position.y, yaw)
        self._poses.append((stamp_s, position.x, position.y, yaw))
        self._trace["speed"].add(time_s, speed)
        drive.way.add(position.x, position.y, self._source)
        self._over_window(time_s, stamp_s, speed)

    def _over_window(self, time_s, stamp_s, speed):
        """Acceleration and curvature of the last while, at the middle of it."""
        recent = self._recent
        if recent and not 0 <= stamp_s - recent[-1][0] < ODOMETRY_SILENT_S:
            recent.clear()  # the clock was set, or something is missing
        recent.append((stamp_s, speed, self._yaw, self._distance_m))
        while stamp_s - recent[0][0] > WINDOW_S:
            recent.popleft()
        span_s = stamp_s - recent[0][0]
        if span_s < WINDOW_S / 2 or len(recent) < 4:
            return
        middle_s = time_s - span_s / 2
        self._trace["acceleration"].add(middle_s, _slope(recent))
        distance_m = self._distance_m - recent[0][3]
        if abs(distance_m) < MIN_DISTANCE_M:
            return
        curvature = (self._yaw - recent[0][2]) / distance_m
        self._trace["turned curvature"].add(middle_s, curvature)
        sent = self._sent
        if (sent is not None and abs(sent) > MIN_CURVATURE and abs(speed) > MIN_SPEED_MPS
                and time_s - self._sent_since_s > STEADY_S):
            bins = self._ratios[0 if sent > 0 else 1]
            bins[min(max(int(curvature / sent * BINS_PER_UNIT), 0), RATIO_BINS - 1)] += 1

    # --- sonars ---

    def _static_tf(self, time_s, message):
        for transform in message.transforms:
            place, turn = transform.transform.translation, transform.transform.rotation
            self._mounts[transform.child_frame_id] = (place.x, place.y, 2 * math.atan2(turn.z, turn.w))

    def _range(self, time_s, message, name):
        drive, range_m = self._drive, message.range
        if not message.min_range < range_m < message.max_range:
            return
        if range_m < drive.nearest_m:
            drive.nearest_m, drive.nearest_s, drive.nearest_sonar = range_m, time_s, name.rsplit("/", 1)[-1]
        mount = self._mounts.get(message.header.frame_id)
        if mount is None:
            drive.sonars_without_place.add(message.header.frame_id)
            return
        if not self._poses:
            return
        stamp_s = _seconds(message.header.stamp, drive.start_ns)
        _, x, y, yaw = min(self._poses, key=lambda pose: abs(pose[0] - stamp_s))
        ahead_m = mount[0] + range_m * math.cos(mount[2])
        left_m = mount[1] + range_m * math.sin(mount[2])
        drive.hits.add(x + ahead_m * math.cos(yaw) - left_m * math.sin(yaw),
                       y + ahead_m * math.sin(yaw) + left_m * math.cos(yaw))

    # --- the Teensy ---

    def _link(self, time_s, message):
        drive, before = self._drive, self._drive.link
        if before is None:
            drive.first_link = message
        else:
            span_s = time_s - self._link_s
            if span_s > 0.5:
                self._trace["frames"].add(time_s, (message.frames - before.frames) / span_s)
                self._trace["bad frames"].add(time_s, (message.bad_frames - before.bad_frames) / span_s)
            for name, words in (("reconnects", "the port was opened again"), ("reboots", "the Teensy started anew")):
                if getattr(message, name) > getattr(before, name):
                    self.fault(time_s, WARN, "Teensy", words)
        if before is None or time_s - self._link_s > 0.5:
            drive.link, self._link_s = message, time_s
        what = ". ".join(filter(None, (message.words, message.next_step)))
        self._lasting(time_s, "link", message.level, "Teensy", f"{message.state}: {what}")
        for counter in message.counters:
            self._error(time_s, counter)

    def _clock(self, time_s, message):
        self._drive.pongs += 1
        self._drive.pongs_unused += not message.used
        self._trace["round trip"].add(time_s, message.round_trip * 1e3)
        if message.converged:
            self._trace["skew"].add(time_s, message.skew)
            self._trace["uncertainty"].add(time_s, message.uncertainty * 1e3)
        offset_ns = _nanoseconds(message.stamp) - message.received
        step_s = 0.0 if self._monotonic_ns is None else (offset_ns - self._monotonic_ns) / NS_PER_S
        if abs(step_s) > CLOCK_SET_S:
            self.fault(time_s, WARN, "computer", f"its clock was set by {step_s:+.3f} s")
        self._monotonic_ns = offset_ns

    def _error(self, time_s, message):
        first, _ = self._drive.counters.get(message.name, (message.count, None))
        self._drive.counters[message.name] = (first, message.count)

    # --- what the nodes say ---

    def _diagnostics(self, time_s, message):
        for status in message.status:
            node, _, report = status.name.partition(": ")
            # Told by a topic of their own, to the moment.
            if report == "steering" and "turn_arb/state" in self._drive.present or \
                    report == "Teensy link" and "teensy_sensor_hub/link" in self._drive.present:
                continue
            self._lasting(time_s, status.name, min(_integer(status.level), ERROR), node.strip("/"), status.message)

    def _log(self, time_s, message):
        warning, error = self._log_levels
        name = message.name.strip("/")
        if message.level < warning or name.endswith("turn_arb") and "turn_arb/state" in self._drive.present:
            return
        key = (name, _kind(message.msg))
        index = self._logged.get(key)
        if index is not None:
            faults = self._drive.faults
            faults[index] = faults[index]._replace(times=faults[index].times + 1)
        elif len(self._drive.faults) < MAX_REPORTED:
            self._logged[key] = len(self._drive.faults)
            self._keep(Fault(time_s, math.nan, ERROR if message.level >= error else WARN, name, message.msg))
        else:
            self._drive.pending += 1


def is_loss(reason: str) -> bool:
    """Whether turn_arb's reason is that something was there and failed, not that nobody asked."""
    return any(sign in reason for sign in LOSS_SIGNS)


def _kind(text):
    """A text without its numbers, which count on while it stays the same."""
    return re.sub(r"[-+]?\d[\d.,e+-]*|inf|nan", "#", text)


def _slope(samples):
    """Of a line through (time, value, …), least squares."""
    count, begin = len(samples), samples[0][0]
    mean_t = sum(sample[0] - begin for sample in samples) / count
    mean_v = sum(sample[1] for sample in samples) / count
    spread = sum((sample[0] - begin - mean_t) ** 2 for sample in samples)
    if not spread:
        return math.nan
    return sum((sample[0] - begin - mean_t) * (sample[1] - mean_v) for sample in samples) / spread


def _median_of(bins):
    """The median of what was counted in bins, and how many there are."""
    total, seen = sum(bins), 0
    for index, count in enumerate(bins):
        seen += count
        if total and seen * 2 >= total:
            return (index + 0.5) / BINS_PER_UNIT, total
    return math.nan, 0


def _integer(level: Any) -> int:
    """A message's byte, which rosbags has as a number or as bytes."""
    return level[0] if isinstance(level, (bytes, bytearray)) else int(level)


def _nanoseconds(stamp):
    return stamp.sec * NS_PER_S + stamp.nanosec


def _seconds(stamp, start_ns):
    return (_nanoseconds(stamp) - start_ns) / NS_PER_S
