"""Summarizes what happened on a drive: its recording is read once, in memory that doesn't grow with its length."""
from __future__ import annotations

from functools import partial, partialmethod
from operator import attrgetter
from typing import Any

from car_interface.common.units import NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.steering.monitor import UNCALIBRATED
from car_interface.throttle.esc import NO_BRAKE
from car_interface.tools.recordings import calibration_result, recording, roles
from car_interface.tools.recordings.calibration_result import CalibrationResult
from car_interface.tools.recordings.columns import MAX_NUMBER, VOLTAGE, value_of, vesc_number
from car_interface.tools.report import states
from car_interface.tools.report.downsample import Traces
from car_interface.tools.report.faults import WARN, Coverage, Fault, FaultLog
from car_interface.tools.report.motion import AskedWatch, Following, ImuWatch, MotionWatch, SonarWatch

# Relative names are below the car's namespace, and so are the others where they are found there.
RANGES = tuple(f"sonar/{name}" for name in SONARS)
VALUE = roles.VALUE._replace(topics=roles.VALUE.topics[:1])  # a VESC's duty cycle comes with its other numbers
# What may be read, and what of Summary takes its messages.
ROLES = {
    roles.ODOM: "motion.on_odom", roles.IMU: "imu.on_imu", roles.OUTPUT: "steering.on_output", VALUE: "on_value",
    roles.ACKERMANN: "asked.on_drive", roles.RADIUS: "on_radius", roles.ACCELERATION: "on_request",
    roles.STICK: "on_stick", roles.BATTERY: "on_battery", roles.VESC: "on_vesc", roles.SERVO: "on_servo",
    roles.MOTOR: "on_motor",
}
TOPICS = {  # without a role: their types, and the same
    "turn_arb/state": ("car_interface/SteeringState", "steering.on_state"),
    "throttle_arb/state": (roles.THROTTLE_STATE["throttle_arb/state"], "throttle.on_state"),
    "planner_interface/state": ("car_interface/PlannerState", "planner.on_state"),
    "teleop_logi/state": ("car_interface/TeleopState", "gamepad.on_state"),
    "/tf_static": ("tf2_msgs/TFMessage", "sonars.on_static_tf"),
    "teensy_sensor_hub/link": ("car_interface/LinkStatus", "teensy.on_link"),
    "teensy_clock": ("car_interface/TeensyClock", "teensy.on_clock"),
    "teensy_error": ("car_interface/Error", "teensy.on_error"),
    calibration_result.TOPIC: ("std_msgs/String", "on_calibration"),
    "/diagnostics": ("diagnostic_msgs/DiagnosticArray", "faults.on_diagnostics"),
    "/rosout": (("rosgraph_msgs/Log", "rcl_interfaces/Log"), "faults.on_log"),
}
# A topic with the name of one of these may be something else: it is not read then.
MAY_BE_OTHERS = (roles.IMU, roles.ACKERMANN, roles.BATTERY, roles.VESC, roles.SERVO, roles.MOTOR)
READS = {**{role.topics[0]: (role.types, name) for role, name in ROLES.items()}, **TOPICS,
         **dict.fromkeys(RANGES, ("sensor_msgs/Range", "sonars.on_range"))}
NEEDED = ("odom", "turn_arb/state", "/servo/output")  # at least one of them


class Summary:
    """What happened on a drive. Times are in seconds since the recording's first message.

    Args:
        recorded: the recording's contents.
        present: those of READS that were recorded.
        wheelbase_m: by which an asked steering angle is a curvature; ``None`` = unknown.
    """

    def __init__(self, path: str, namespace: str, recorded: recording.Contents, present: set,
                 wheelbase_m: float | None):
        self.path, self.namespace = path, namespace
        self.start_ns = recorded.start_ns  # ROS time of the first message
        self.duration_s = (recorded.end_ns - recorded.start_ns) / NS_PER_S
        self.topics, self.present = recorded.topics, present
        self.notes: list = []  # a line for each topic that was named, guessed or not found, or is odd
        self.calibration: CalibrationResult | None = None  # of a calibration drive, which drove by the table before
        self.traces, self.faults = Traces(self.duration_s), FaultLog(present)
        self.coverage = Coverage(recording.prefix(namespace), self.duration_s)
        found = self.traces, self.faults
        self.gamepad, self.limits = states.GamepadWatch(*found), states.LimitsWatch()
        self.steering = states.SteeringWatch(*found, self.gamepad)
        self.throttle, self.planner = states.ThrottleWatch(*found), states.PlannerWatch(*found)
        # Where one state wasn't recorded, the other's stands for both: before throttle_arb who steered drove, too.
        steering, throttle, planner = (watch if f"{watch.node}/state" in present else None
                                       for watch in (self.steering, self.throttle, self.planner))
        steering, throttle = steering or throttle, throttle or steering
        self.asked = AskedWatch(self.traces, wheelbase_m, steering, throttle, planner)
        self.motion = MotionWatch(*found, self.steering, self.asked, throttle, self.start_ns)
        self.imu, self.sonars = ImuWatch(self.traces, self.motion), SonarWatch(self.motion)
        self.teensy = states.TeensyWatch(*found)

    def handlers(self) -> dict:
        """Return functions of time in s and message for each of READS."""
        found = {topic: [attrgetter(name)(self)] for topic, (_, name) in READS.items()}
        for topic in RANGES:
            found[topic] = [partial(self.sonars.on_range, topic=topic)]
        for node in (self.steering.node, self.throttle.node):
            found[f"{node}/state"].append(partial(self.limits.on_state, node=node))
        return found

    def finish(self, steps_back: int) -> None:
        """End what lasts, and drop what is no fault of this drive, whose clock was set back so often."""
        if steps_back:
            times = "once" if steps_back == 1 else f"{steps_back} times"
            self.faults.add(Fault(0.0, WARN, "recording", f"its time went back {times}: the clock was set"))
        for watch in (self.steering, self.throttle, self.planner, self.limits, self.gamepad):
            watch.finish()
        self.faults.dropped += self.steering.dropped + self.throttle.dropped
        self.faults.finish(self.steering.driven_from_s())
        if self.calibration is not None:  # its table is to be replaced, and it keeps room to coast in
            self.motion.by_tables = Following(self.steering)
            self.faults.entries[:] = [fault for fault in self.faults.entries if not (
                UNCALIBRATED in fault.what or fault.what.startswith(NO_BRAKE))]

    def on_number(self, trace: str, time_s: float, message: Any) -> None:
        """Take a message with a number."""
        self.traces[trace].add(time_s, value_of(message))

    on_value, on_stick = partialmethod(on_number, "value"), partialmethod(on_number, "gamepad")
    on_servo, on_motor = partialmethod(on_number, "servo position"), partialmethod(on_number, "motor speed asked")

    def on_radius(self, time_s: float, message: Any) -> None:
        """Take a std_msgs/Float32: the planner's turn radius in m; 0 requests nothing."""
        if message.data:
            self.traces["requested curvature"].add(time_s, 1 / message.data)

    def on_request(self, time_s: float, message: Any) -> None:
        """Take the acceleration that a planner requests."""
        self.traces["requested acceleration"].add(time_s, message.longitudinal.acceleration)
        self.motion.accelerating.request(time_s, message.longitudinal.acceleration)

    def on_vesc(self, time_s: float, message: Any) -> None:
        """Take a VESC's telemetry; a voltage or a value that has a topic of its own goes before. Speeds are in ERPM."""
        self.traces["motor speed"].add(time_s, message.state.speed)
        if "generic/output/value" not in self.present:
            self.on_number("value", time_s, message)
        if "battery_state" not in self.present:
            self.on_battery(time_s, message)

    def on_battery(self, time_s: float, message: Any) -> None:
        """Take a sensor_msgs/BatteryState, or a VESC's telemetry."""
        voltage_v = vesc_number(message, VOLTAGE) if hasattr(message, "state") else message.voltage
        if 0 < voltage_v <= MAX_NUMBER:  # 0 and NaN: it isn't measured; more than that: garbage
            self.traces["battery voltage"].add(time_s, voltage_v)

    def on_calibration(self, time_s: float, message: Any) -> None:
        """Take a calibration drive's result."""
        try:
            self.calibration = calibration_result.parsed(message.data)
        except ValueError as error:
            self.notes.append(str(error))


def summarize(path: str, namespace: str = "/", wheelbase_m: float | None = None, progress: bool = False,
              **given: str) -> Summary:
    """Summarize a recording.

    Args:
        wheelbase_m: by which an asked steering angle is a curvature; ``None`` = unknown.
        progress: show a bar on a terminal.
        given: topics that the user named, by the names of ROLES.

    Raises:
        NoRecording: it can't be read, or has nothing for a report.
    """
    has = recording.contents(path)
    if given:
        recording.require(path, {given[role.name]: role.types for role in ROLES if role.name in given}, namespace)
    found = {role: roles.find(has.topics, role, namespace, given) for role in ROLES}
    keys = {**{one.topic: role.topics[0] for role, one in found.items()
               if role.name in given or (one.fits if role in MAY_BE_OTHERS else one.is_there)},
            **{topic: topic for topic in (*TOPICS, *RANGES)}}
    types = {topic: READS[name][0] for topic, name in keys.items()}
    with_messages = {name: topic for name, topic in has.topics.items() if topic.count}
    names = recording.absolute_names(with_messages, types, namespace)
    below = recording.prefix(namespace)  # an absolute name may be another car's
    if not any(keys[requested] in NEEDED and name.startswith(below) for name, requested in names.items()):
        odom = found[roles.ODOM]
        raise recording.NoRecording(f"{path} has no message of {odom.topic}, turn_arb/state or /servo/output"
                                    + _elsewhere(with_messages, namespace, odom.note))
    summary = Summary(path, namespace, has, {keys[name] for name in names.values()}, wheelbase_m)
    summary.notes += [f"{name}: {topic} (as you say)" for name, topic in given.items()]
    summary.notes += [one.note for one in found.values() if one.note]
    handlers, before_ns, steps_back = summary.handlers(), 0, 0
    for recorded in recording.read(path, types, namespace, progress):
        key, time_s = keys[recorded.topic], (recorded.time_ns - summary.start_ns) / NS_PER_S
        steps_back += before_ns - recorded.time_ns > NS_PER_S
        before_ns = recorded.time_ns
        try:
            summary.coverage.update(time_s, key, recorded.message)
            for handler in handlers[key]:
                handler(time_s, recorded.message)
        except AttributeError as error:
            raise recording.other_version(path, recorded) from error
    summary.finish(steps_back)
    summary.notes += filter(None, [summary.motion.note(found[roles.ODOM].topic),
                                   summary.imu.gravity.note(found[roles.IMU].topic)])
    return summary


def _elsewhere(topics, namespace, note):
    """Return a hint at where there is what is missing, or the note on odometry."""
    spaces = roles.other_cars(topics, namespace)
    place = f" below {namespace}" if namespace.strip("/") else ""
    if spaces:
        return f"{place}: try " + " or ".join(f"--ns {space}" for space in sorted(spaces))
    if place and any("/" + name.lstrip("/") in topics for name in NEEDED):
        return f"{place}: try it without --ns"
    if note:
        return f"{place}. {note}"
    return f"{place}; it has " + (", ".join(list(topics)[:8]) or "no topic at all")
