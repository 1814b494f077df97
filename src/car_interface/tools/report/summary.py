"""Summarizes what happened on a drive: its recording is read once, in memory that doesn't grow with its length."""
from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.steering.monitor import UNCALIBRATED
from car_interface.throttle.esc import NO_BRAKE
from car_interface.tools.recordings import calibration_result, roles
from car_interface.tools.recordings.calibration_result import CalibrationResult
from car_interface.tools.recordings.columns import VOLTAGE, value_of, vesc_number
from car_interface.tools.recordings.recording import (
    NoRecording,
    absolute_names,
    check_types,
    contents,
    other_version,
    read,
    require,
)
from car_interface.tools.recordings.roles import find, fits, other_cars, without
from car_interface.tools.report import motion, states
from car_interface.tools.report.coverage import Coverage, both
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import WARN, FaultLog, NodeReports
from car_interface.tools.report.motion import AskedWatch, ImuWatch, MotionWatch, SonarWatch
from car_interface.tools.report.states import (
    Drivers,
    GamepadWatch,
    LimitsWatch,
    PlannerWatch,
    SteeringWatch,
    TeensyWatch,
    ThrottleWatch,
)

# Relative names are below the car's namespace, and so are the others where they are found there.
RANGES = tuple(f"sonar/{name}" for name in SONARS)
VALUE = roles.VALUE._replace(topics=roles.VALUE.topics[:1])  # a VESC's duty cycle comes with its other numbers
ROLES = (roles.ODOM, roles.IMU, roles.OUTPUT, VALUE, roles.ACKERMANN, roles.RADIUS, roles.ACCELERATION, roles.STICK,
         roles.BATTERY, roles.VESC, roles.SERVO, roles.MOTOR)
ROLE_OF = {role.topics[0]: role for role in ROLES}
# A topic with the name of one of these may be something else: it is not read then.
MAY_BE_OTHERS = (roles.IMU, roles.ACKERMANN, roles.BATTERY, roles.VESC, roles.SERVO, roles.MOTOR)
TYPES = {
    **{role.topics[0]: role.types for role in ROLES},
    **roles.THROTTLE_STATE,
    "turn_arb/state": "car_interface/SteeringState",
    "planner_interface/state": "car_interface/PlannerState",
    "teleop_logi/state": "car_interface/TeleopState",
    **dict.fromkeys(RANGES, "sensor_msgs/Range"),
    "/tf_static": "tf2_msgs/TFMessage",
    "teensy_sensor_hub/link": "car_interface/LinkStatus",
    "teensy_clock": "car_interface/TeensyClock",
    "teensy_error": "car_interface/Error",
    calibration_result.TOPIC: "std_msgs/String",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/rosout": ("rosgraph_msgs/Log", "rcl_interfaces/Log"),
}
NEEDED = ("odom", "turn_arb/state", "/servo/output")  # at least one of them
TRACES = (*states.TRACES, *motion.TRACES, "requested acceleration", "value", "battery voltage", "servo position",
          "motor speed asked", "motor speed")  # the last two in ERPM


@dataclass
class Summary:
    """What happened on a drive. Times are in seconds since the recording's first message."""

    path: str  # of the recording
    namespace: str
    start_ns: int  # ROS time of the first message
    duration_s: float
    topics: dict  # what it has: a recordings.recording.Topic by name
    notes: list  # a line for each topic that was named, guessed or not found, and for what is odd about one
    present: set  # those of TYPES that were recorded
    traces: dict  # a Trace for each of TRACES
    gamepad: GamepadWatch
    steering: SteeringWatch
    throttle: ThrottleWatch
    limits: LimitsWatch
    asked: AskedWatch
    planner: PlannerWatch
    motion: MotionWatch
    imu: ImuWatch
    sonars: SonarWatch
    teensy: TeensyWatch
    faults: FaultLog
    coverage: Coverage
    calibration: CalibrationResult | None = None  # of a calibration drive, which drove by the table before

    def on_calibration(self, time_s: float, message: Any) -> None:
        """Take a calibration drive's result."""
        try:
            self.calibration = calibration_result.parsed(message.data)
        except ValueError as error:
            self.notes.append(str(error))


def summarize(path: str, namespace: str = "/", wheelbase_m: float | None = None, progress: bool = False,
              **topics: str | None) -> Summary:
    """Summarize a recording.

    Args:
        wheelbase_m: by which an asked steering angle is a curvature; ``None`` = unknown.
        progress: show a bar on a terminal.
        topics: named by the user, by the names of ROLES; ``None`` = not named.

    Raises:
        NoRecording: it can't be read, or has nothing for a report.
    """
    has = contents(path)
    given = {name: topic for name, topic in topics.items() if topic is not None}
    if given:
        named = {given[role.name]: role.types for role in ROLES if role.name in given}
        require(path, named, namespace)
        check_types(path, named, namespace)
    free = {role.name: without(has.topics, given, role, namespace) for role in ROLES}
    found = {role.topics[0]: find(free[role.name], role, namespace, given.get(role.name)) for role in ROLES}
    keys = {found[name].topic if name in found else name: name for name in TYPES
            if name not in found or _is_read(has.topics, free, found[name].topic, ROLE_OF[name], given, namespace)}
    types = {topic: TYPES[name] for topic, name in keys.items()}
    with_messages = {name: topic for name, topic in has.topics.items() if topic.count}
    names = absolute_names(with_messages, types, namespace)
    below = "/" + "/".join([*filter(None, namespace.split("/")), ""])  # an absolute name may be another car's
    if not any(keys[requested] in NEEDED and name.startswith(below) for name, requested in names.items()):
        odom = found["odom"]
        raise NoRecording(f"{path} has no message of {odom.topic}, turn_arb/state or /servo/output"
                          + _elsewhere(with_messages, namespace, odom.note))
    summary = _empty(path, namespace, has, {keys[name] for name in names.values()}, wheelbase_m)
    summary.notes += [f"{name}: {topic} (as you say)" for name, topic in given.items()]
    summary.notes += [one.note for one in found.values() if one.note]
    handlers = summary.coverage.watched(_handlers(summary))
    for recorded in read(path, types, namespace, progress):
        try:
            handlers[keys[recorded.topic]]((recorded.time_ns - summary.start_ns) / NS_PER_S, recorded.message)
        except AttributeError as error:
            raise other_version(path, recorded) from error
    if has.steps_back:
        times = "once" if has.steps_back == 1 else f"{has.steps_back} times"
        summary.faults.add_moment(0.0, WARN, "recording", f"its time went back {times}: the clock was set")
    for watch in (summary.steering, summary.throttle, summary.planner, summary.limits, summary.gamepad):
        watch.finish()
    summary.faults.finish(summary.steering.driven_from_s)
    if summary.calibration is not None:
        summary.faults.entries[:] = [fault for fault in summary.faults.entries if not _is_meant(fault)]
    summary.notes += filter(None, [summary.motion.note(found["odom"].topic), summary.imu.note(found["imu/data"].topic)])
    return summary


def _is_meant(fault):
    """Return whether a calibration drive means it: its table is to be replaced, and it keeps room to coast in."""
    return UNCALIBRATED in fault.what or fault.what.startswith(NO_BRAKE)


def _is_read(recorded, free, topic, role, given, namespace):
    """Return whether the topic that was found for a role is read as that."""
    if role.name in given:
        return True
    if role in MAY_BE_OTHERS:
        return fits(free[role.name], topic, role, namespace)
    names = absolute_names(recorded, [topic], namespace)
    return names.keys() <= free[role.name].keys()


def _empty(path, namespace, has, present, wheelbase_m):
    duration_s = (has.end_ns - has.start_ns) / NS_PER_S
    traces = {name: Trace(duration_s) for name in TRACES}
    faults = FaultLog()
    gamepad = GamepadWatch(faults, duration_s)
    steering = SteeringWatch(traces, faults, duration_s, gamepad)
    throttle, planner = ThrottleWatch(traces, faults, duration_s), PlannerWatch(traces, faults, duration_s)
    drivers = Drivers(steering, throttle, planner, present)
    wanted = AskedWatch(traces, wheelbase_m, drivers)
    moves = MotionWatch(traces, faults, steering, wanted, drivers, has.start_ns)
    return Summary(path, namespace, has.start_ns, duration_s, has.topics, [], present, traces, gamepad, steering,
                   throttle, LimitsWatch(), wanted, planner, moves, ImuWatch(traces, moves),
                   SonarWatch(moves, has.start_ns), TeensyWatch(traces, faults), faults,
                   Coverage(namespace, duration_s))


def _handlers(summary):
    """Return a function of time in s and message for each of TYPES."""
    steering, teensy, traces = summary.steering, summary.teensy, summary.traces
    log_type = next((topic.type for name, topic in summary.topics.items() if name.lstrip("/") == "rosout"), "")
    nodes = NodeReports(summary.faults, summary.present, log_type)
    return {
        "turn_arb/state": both(steering.on_state, partial(summary.limits.on_state, node="turn_arb")),
        "throttle_arb/state": both(summary.throttle.on_state, partial(summary.limits.on_state, node="throttle_arb")),
        "planner_interface/state": summary.planner.on_state,
        "teleop_logi/state": summary.gamepad.on_state,
        "/servo/output": steering.on_output,
        "av_turnrad_req": partial(_on_radius, traces["requested curvature"]),
        "/teleop_logi/tele_steer_req": partial(_add_number, traces["gamepad"]),
        "odom": summary.motion.on_odom,
        "imu/data": summary.imu.on_imu,
        "drive": summary.asked.on_drive,
        "control/command/control_cmd": partial(_on_request, summary),
        "generic/output/value": partial(_add_number, traces["value"]),
        "battery_state": lambda time_s, message: _add_voltage(summary, time_s, message.voltage),
        "sensors/core": partial(_on_vesc, summary),
        "sensors/servo_position_command": partial(_add_number, traces["servo position"]),
        "commands/motor/speed": partial(_add_number, traces["motor speed asked"]),
        **{name: partial(summary.sonars.on_range, topic=name) for name in RANGES},
        "/tf_static": summary.sonars.on_static_tf,
        "teensy_sensor_hub/link": teensy.on_link,
        "teensy_clock": teensy.on_clock,
        "teensy_error": teensy.on_error,
        calibration_result.TOPIC: summary.on_calibration,
        "/diagnostics": nodes.on_diagnostics,
        "/rosout": nodes.on_log,
    }


def _add_number(trace, time_s, message):
    trace.add(time_s, value_of(message))


def _on_radius(trace, time_s, message):
    """Take a std_msgs/Float32: the planner's turn radius in m; 0 requests nothing."""
    if message.data:
        trace.add(time_s, 1 / message.data)


def _on_request(summary, time_s, message):
    """Take the acceleration that a planner requests."""
    summary.traces["requested acceleration"].add(time_s, message.longitudinal.acceleration)
    summary.motion.accelerating.request(time_s, message.longitudinal.acceleration)


def _on_vesc(summary, time_s, message):
    """Take a VESC's telemetry; a voltage or a value that has a topic of its own goes before."""
    summary.traces["motor speed"].add(time_s, message.state.speed)
    if "generic/output/value" not in summary.present:
        _add_number(summary.traces["value"], time_s, message)
    if "battery_state" not in summary.present:
        _add_voltage(summary, time_s, vesc_number(message, VOLTAGE))


def _add_voltage(summary, time_s, voltage_v):
    if voltage_v > 0:  # 0 and NaN: it isn't measured
        summary.traces["battery voltage"].add(time_s, voltage_v)


def _elsewhere(topics, namespace, note):
    """Return a hint at where there is what is missing, or the note on odometry."""
    spaces = other_cars(topics, namespace)
    place = f" below {namespace}" if namespace.strip("/") else ""
    if spaces:
        return f"{place}: try " + " or ".join(f"--ns {space}" for space in sorted(spaces))
    if place and any("/" + name.lstrip("/") in topics for name in NEEDED):
        return f"{place}: try it without --ns"
    if note:
        return f"{place}. {note}"
    return f"{place}; it has " + (", ".join(list(topics)[:8]) or "no topic at all")
