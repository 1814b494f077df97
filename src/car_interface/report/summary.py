"""What happened on a drive, from its recording: read in one pass, in memory that doesn't grow with its length."""
from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from car_interface.common.units import NS_PER_S
from car_interface.recordings.recording import NoRecording, absolute_names, contents, other_version, read
from car_interface.report import motion, steering_state, teensy_link, throttle_state
from car_interface.report.coverage import Coverage
from car_interface.report.downsample import Trace
from car_interface.report.faults import WARN, FaultLog, NodeReports
from car_interface.report.gamepad import GamepadWatch
from car_interface.report.limits_state import LimitsWatch
from car_interface.report.motion import MotionWatch
from car_interface.report.sonars import SonarWatch
from car_interface.report.steering_state import SteeringWatch
from car_interface.report.teensy_link import TeensyWatch
from car_interface.report.throttle_state import ThrottleWatch

# Relative names are below the car's namespace, and so are the others where they are found there.
SONARS = tuple(f"sonar/{end}_{side}" for end in ("front", "rear") for side in ("right", "middle", "left"))
TYPES = {
    "turn_arb/state": "car_interface/SteeringState",
    "throttle_arb/state": "car_interface/ThrottleState",
    "teleop_logi/state": "car_interface/TeleopState",
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
NEEDED = ("odom", "turn_arb/state", "/servo/output")  # at least one of them
TRACES = (*steering_state.TRACES, *throttle_state.TRACES, *motion.TRACES, "requested acceleration", "value",
          *teensy_link.TRACES)


@dataclass
class Summary:
    """What happened on a drive. Times are in seconds since the recording's first message.

    Attributes:
        path, namespace, start_ns, duration_s: of the recording.
        topics: what it has: a recordings.recording.Topic by name.
        present: those of TYPES that were recorded.
        traces: a Trace for each of TRACES.
        gamepad, steering, throttle, limits, motion, sonars, teensy: see their classes.
        faults: what went wrong.
        coverage: which questions the recording can't answer.
    """

    path: str
    namespace: str
    start_ns: int
    duration_s: float
    topics: dict
    present: set
    traces: dict
    gamepad: GamepadWatch
    steering: SteeringWatch
    throttle: ThrottleWatch
    limits: LimitsWatch
    motion: MotionWatch
    sonars: SonarWatch
    teensy: TeensyWatch
    faults: FaultLog
    coverage: Coverage


def summarize(path: str, namespace: str = "/", odom: str = "odom", progress: bool = False) -> Summary:
    """Summarize a recording.

    Args:
        path: of the recording.
        namespace: the car's.
        odom: the topic of its odometry.
        progress: show a bar on a terminal.

    Raises:
        NoRecording: it can't be read, or has nothing for a report.
    """
    has = contents(path)
    types = {(odom if name == "odom" else name): kind for name, kind in TYPES.items()}
    with_messages = {name: topic for name, topic in has.topics.items() if topic.count}
    names = absolute_names(with_messages, types, namespace)
    below = "/" + "/".join([*filter(None, namespace.split("/")), ""])  # an absolute name may be another car's
    needed = {odom if name == "odom" else name for name in NEEDED}
    if not any(requested in needed and name.startswith(below) for name, requested in names.items()):
        raise NoRecording(f"{path} has no message of {odom}, turn_arb/state or /servo/output"
                          + _elsewhere(with_messages, namespace))
    summary = _empty(path, namespace, has, {"odom" if name == odom else name for name in names.values()})
    handlers = summary.coverage.watched(_handlers(summary))
    for recorded in read(path, types, namespace, progress):
        name = "odom" if recorded.topic == odom else recorded.topic
        try:
            handlers[name]((recorded.time_ns - summary.start_ns) / NS_PER_S, recorded.message)
        except AttributeError as error:
            raise other_version(path, recorded) from error
    if has.steps_back:
        times = "once" if has.steps_back == 1 else f"{has.steps_back} times"
        summary.faults.add_moment(0.0, WARN, "recording", f"its time went back {times}: the clock was set")
    summary.steering.finish()
    summary.throttle.finish()
    summary.limits.finish()
    summary.gamepad.finish()
    summary.motion.finish()
    summary.faults.finish()
    return summary


def _empty(path, namespace, has, present):
    duration_s = (has.end_ns - has.start_ns) / NS_PER_S
    traces = {name: Trace(0.0, duration_s) for name in TRACES}
    faults = FaultLog()
    gamepad = GamepadWatch(faults, duration_s)
    steering = SteeringWatch(traces, faults, duration_s, gamepad)
    moves = MotionWatch(traces, faults, steering, has.start_ns)
    return Summary(path, namespace, has.start_ns, duration_s, has.topics, present, traces, gamepad, steering,
                   ThrottleWatch(traces, faults, duration_s), LimitsWatch(), moves, SonarWatch(moves, has.start_ns),
                   TeensyWatch(traces, faults), faults, Coverage(namespace, duration_s))


def _handlers(summary):
    """A function of time in s and message for each of TYPES."""
    steering, teensy, traces = summary.steering, summary.teensy, summary.traces
    log_type = next((topic.type for name, topic in summary.topics.items() if name.lstrip("/") == "rosout"), "")
    nodes = NodeReports(summary.faults, summary.present, log_type)
    return {
        "turn_arb/state": _both(steering.on_state, partial(summary.limits.on_state, node="turn_arb")),
        "throttle_arb/state": _both(summary.throttle.on_state, partial(summary.limits.on_state, node="throttle_arb")),
        "teleop_logi/state": summary.gamepad.on_state,
        "/servo/output": steering.on_output,
        "av_turnrad_req": steering.on_planner,
        "/teleop_logi/tele_steer_req": steering.on_gamepad,
        "odom": summary.motion.on_odom,
        "control/command/control_cmd": lambda time_s, message: traces["requested acceleration"].add(
            time_s, message.longitudinal.acceleration),
        "generic/output/value": lambda time_s, message: traces["value"].add(time_s, message.data),
        **{name: partial(summary.sonars.on_range, topic=name) for name in SONARS},
        "/tf_static": summary.sonars.on_static_tf,
        "teensy_sensor_hub/link": teensy.on_link,
        "teensy_clock": teensy.on_clock,
        "teensy_error": teensy.on_error,
        "/diagnostics": nodes.on_diagnostics,
        "/rosout": nodes.on_log,
    }


def _both(first, second):
    """A handler that calls two."""
    def handle(time_s, message):
        first(time_s, message)
        second(time_s, message)
    return handle


def _elsewhere(topics, namespace):
    """A hint at the namespaces that have what is missing."""
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
