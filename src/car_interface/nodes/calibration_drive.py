"""The calibration_drive program: the car calibrates its steering while a person holds the autonomous deadman.

It is started by hand, in a terminal of its own; ``--help`` lists its options. It steers and drives by a planner's
topics, so that deadman, e-stop, arming and timeouts hold as for any planner, and asks for nothing while it may not
drive. With --stick a person drives, and it says where to hold the stick.

A person without its terminal, such as at a phone, sees how far it is by ~state, and ends it by ~finish or a signal.

Publishes, at 50 Hz while it may drive, without --stick:
    av_steer_req (std_msgs/Float32): −1 right .. +1 left.
    av_speed_req (std_msgs/Float32): m/s, for planner_interface with source ``speed``.
And:
    ~markers (visualization_msgs/MarkerArray, latched, 5 Hz): the area, where it goes, what is known of which radius;
        with --stick what to do in place of the first two.
    ~state (CalibrationState, 5 Hz): what it does or waits for, what is known and what is missing.
    ~result (std_msgs/String, at the end): the new table, for the recording, of which bag_report makes the page.
Subscribes:
    odom (nav_msgs/Odometry), servo/output (std_msgs/Int32MultiArray): what it measures.
    turn_arb/state (SteeringState), throttle_arb/state (ThrottleState), planner_interface/state (PlannerState),
        teleop_logi/state (TeleopState): whether it may drive, and why not.
    sonar/front_right … sonar/rear_left (sensor_msgs/Range): without --no-sonars.
    av_turnrad_req, av_steer_req, av_speed_req (std_msgs/Float32): who else asks.
    ~finish (std_msgs/Empty): finish now with what is known, as by the key F.
Parameters: none of its own; it reads those of turn_arb and throttle_arb.
"""
from __future__ import annotations

import math
import os
import sys
import textwrap
from functools import partial

import rospy
from geometry_msgs.msg import Point, Pose, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from std_msgs.msg import ColorRGBA, Empty, Float32, Header, Int32MultiArray, String
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.common.errors import CarInterfaceError, EndedEarly
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import CHANNELS, NS_PER_S, yaw_rad
from car_interface.msg import CalibrationState, PlannerState, SteeringState, TeleopState, ThrottleState
from car_interface.nodes.bag_recording import TOPICS, BagRecording
from car_interface.nodes.car_display import NO_ROTATION, marker
from car_interface.nodes.terminal import Keys, LiveText
from car_interface.ros.clocks import RosClock
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, sender_of, subscribe
from car_interface.steering.config import calibration_of
from car_interface.tools.calibration.drive import terminal
from car_interface.tools.calibration.drive.calibration_drive import CalibrationDrive, StickGuide
from car_interface.tools.calibration.drive.conclusion import board_center, conclude, find_table_file, next_steps
from car_interface.tools.calibration.drive.config import drive_config, parse
from car_interface.tools.calibration.drive.grant import STATES, Grant
from car_interface.tools.calibration.drive.knowledge import assess
from car_interface.tools.calibration.drive.survey import BLOCKED, DONE, PAUSED, WAITING, Progress

NAME = "calibration_drive"
RATE_HZ, TICKS_PER_SHOW = 50, 10
PLAIN_PERIOD_NS = 10 * NS_PER_S  # between two lines where nothing can be drawn over
READY_WITHIN_NS, RECORDER_WITHIN_NS = 8 * NS_PER_S, 15 * NS_PER_S
RESULT_ARRIVES_NS = NS_PER_S  # until the recording is closed
MAX_ODOM_AGE_NS = NS_PER_S // 2  # an older one has an odd stamp
NO_PROGRESS = Progress()  # before the drive and after it
STANDS = frozenset({WAITING, PAUSED, BLOCKED})
REQUESTS = ("av_turnrad_req", "av_steer_req", "av_speed_req")
# Of the picture in rviz.
CIRCLE_POINTS, CROSS_M = 72, 0.15
LINE_M, HEIGHT_M = 0.02, 0.02
ARC_M, MAX_ARC_RAD, ARC_STEPS = 1.6, 2.6, 16  # of the arcs by radius, from the car
WIDEST_M = 40.0  # wider turns can't be told from straight on
TEXT_M, TEXT_COLUMNS = 0.14, 28
BEHIND_M, ABOVE_M = 0.8, 0.7  # where no arc lies, and seen from above still over car_display's two lines
AREA, PATH = ColorRGBA(0.35, 0.35, 0.4, 1.0), ColorRGBA(0.75, 0.0, 0.75, 1.0)
TEXT = ColorRGBA(0.1, 0.1, 0.1, 1.0)
# Of the arcs, by their marks. None is blue as the trail, which car_display draws, or as orange as its arrow.
COLORS = {terminal.KNOWN: ColorRGBA(0.0, 0.6, 0.2, 0.9), terminal.PARTLY: ColorRGBA(0.95, 0.75, 0.0, 0.9),
          terminal.UNKNOWN: ColorRGBA(0.85, 0.1, 0.1, 0.9)}


class CalibrationDriveNode:
    """Carry messages to the drive and its requests to the car, show how far it is, and write the result.

    Args:
        text, keys: the terminal; ``None`` = the one that the program runs in.
        make_recording: as ``BagRecording``.
    """

    def __init__(self, wanted, params, inbox, text=None, keys=None, make_recording=BagRecording):
        params.finish()  # it has options instead, which don't stay on the server
        graph, self._clocks = inbox.graph, inbox.clocks
        self._wanted, self._inbox = wanted, inbox
        base = self._base = calibration_of(graph.parameter("turn_arb", {}))
        self._table = find_table_file(wanted.output, wanted.base, graph.parameter("turn_arb/save_to", None), base)
        self._config = config = drive_config(wanted, graph.parameter("throttle_arb", {}))
        self._drive = (StickGuide if wanted.stick else CalibrationDrive)(base, config)
        self._grant = Grant(wanted.stick, bool(graph.parameter("throttle_arb/esc/calibration_drive", False)),
                            config.obstacles.mounts)
        self._clock, self._text, self._keys = RosClock(inbox.clocks), text or LiveText(), keys or Keys()
        self._make_recording = make_recording
        now_ns = self._clocks.now_ns()
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._enter(self._check, now_ns)
        self._recording = self._refusal = None
        self._shown_kind, self._shown_ns = "", 0
        self._frames = "odom", "base_link"
        self._requests = ()  # to steer and to drive, while it asks for something
        self._is_over = self._is_written = False
        self._result = advertise("~result", String, inbox)
        self._state = advertise("~state", CalibrationState, inbox)
        self._markers = advertise("~markers", MarkerArray, inbox, latch=True)
        self._subscribe()
        self._has_keys = self._keys.start()
        self._say(terminal.introduction(wanted.stick, config.radius_m))
        self._text.say(f"It will write {self._table.path}.")
        if self._has_keys:
            self._text.say("F: finish now with what is known. Q: give up.")

    def _subscribe(self):
        inbox = self._inbox
        for topic, message_type, handler in (
                ("odom", Odometry, self._on_odometry), ("servo/output", Int32MultiArray, self._on_output),
                *((f"{name}/state", message_type, partial(self._grant.update, name)) for name, message_type in zip(
                    STATES, (SteeringState, ThrottleState, PlannerState, TeleopState))),
                *((f"sonar/{name}", Range, partial(self._on_range, name)) for name in self._grant.sonars)):
            subscribe(topic, message_type, inbox, handler, queue_size=50)
        subscribe("~finish", Empty, inbox, lambda message, now_ns: self._drive.finish())
        for topic in REQUESTS if not self._wanted.stick else ():
            subscribe(topic, rospy.AnyMsg, inbox, partial(self._on_request, topic), wakes=False)

    def step(self, now_ns):
        """Handle what arrived; then the stage."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            typed = ((self._keys.read() or "") if self._has_keys else "").lower()
            if "q" in typed:
                self._inbox.end()
            self._stage(now_ns, typed)
        return self._timer.due_ns

    def shut_down(self):
        """Stop the car, close the bag, restore the terminal. A drive that isn't over has failed."""
        self._stop_asking()
        self._markers.publish(no_markers(self._frames[0]))
        self._keys.restore()
        self._text.keep()
        if self._recording is not None and not self._is_over:
            self._text.say(f"recording: {self._recording.stop()}")
        if not (self._is_over or self._is_written) and sys.exc_info()[0] is None:
            raise EndedEarly("ended before it was over: nothing is written")

    # --- what arrives ---

    def _on_odometry(self, message, now_ns):
        self._grant.has_odom = True
        self._frames = message.header.frame_id or "odom", message.child_frame_id or "base_link"
        measured_ns = self._clock.monotonic_ns(message.header.stamp)
        if not 0 <= now_ns - measured_ns <= MAX_ODOM_AGE_NS:
            measured_ns = now_ns
        pose = message.pose.pose
        self._drive.update_odometry(pose.position.x, pose.position.y, yaw_rad(pose.orientation),
                                    message.twist.twist.linear.x, measured_ns, now_ns)

    def _on_output(self, message, now_ns):
        if len(message.data) == CHANNELS:
            self._grant.duty = duty = message.data[self._base.servo_channel]
            self._drive.update_duty(duty, now_ns)

    def _on_range(self, name, message, now_ns):
        if name in self._grant.sonars:
            self._grant.sonars.remove(name)
        self._drive.update_range(name, message.range, now_ns)

    def _on_request(self, topic, message, now_ns):
        sender = sender_of(message)
        if sender != self._inbox.graph.process_name():
            self._grant.update_other(self._inbox.resolve_name(topic), sender, now_ns)

    # --- before the drive ---

    def _check(self, now_ns, typed):
        """Wait until all is there; what only another launch would bring isn't waited for long."""
        lacks = list(self._grant.missing(now_ns))
        missing, waited_ns = [*lacks, *self._grant.missing_gamepad()], now_ns - self._begun_ns
        if not missing:
            topics = list(map(self._inbox.resolve_name, (*TOPICS, "~result")))
            self._recording = self._make_recording(str(self._table.path.parent), topics, self._table.path.stem)
            self._enter(self._await_recorder, now_ns)
        elif lacks and waited_ns > READY_WITHIN_NS:
            self._text.show([])
            self._say(*(f"  - {text}" for text in missing))
            are = "these are" if len(missing) > 1 else "this is"
            raise CarInterfaceError(f"it can't begin: {are} missing, see above")
        elif waited_ns > NS_PER_S and self._timer.ticks % TICKS_PER_SHOW == 0:
            self._announce("waiting", [f"waits: {text}" for text in missing], now_ns)
            self._publish_state(WAITING, "; ".join(missing))

    def _await_recorder(self, now_ns, typed):
        recording = self._recording
        if self._timer.ticks % RATE_HZ or not recording.has_subscribed(self._inbox.resolve_name("odom")):
            if not recording.has_ended and now_ns - self._begun_ns <= RECORDER_WITHIN_NS:
                return
            self._say("no recording: rosrun rosbag record doesn't run; the calibration doesn't need it")
        if not self._wanted.stick:
            self._requests = tuple(advertise(topic, Float32, self._inbox) for topic in REQUESTS[1:])
        self._enter(self._go, now_ns)

    # --- the drive ---

    def _go(self, now_ns, typed):
        """Ask for the next step, and show how far it is."""
        drive = self._drive
        if "f" in typed:
            drive.finish()
        task = drive.take_fit_task()
        if task is not None:
            self._inbox.work(partial(assess, *task), drive.update_knowledge)
        drive.is_slowed = self._grant.is_slowed
        step = drive.step(now_ns, self._grant.trouble(now_ns))
        if step.steering is not None:
            self._ask_for(step.steering, step.speed_mps)
        if self._timer.ticks % TICKS_PER_SHOW == 0 or step.phase == DONE:
            self._show(step, now_ns)
        if step.phase == DONE:
            self._begin_end(f"{step.text}. You can let go. Calibrating …")

    def _show(self, step, now_ns):
        progress = self._drive.progress()
        self._announce(step.phase if step.phase in STANDS else "drives",
                       terminal.drive_lines(step, progress) if self._text.is_live else
                       [terminal.plain_line(step.phase, step.text, progress)], now_ns)
        text = step.text if self._wanted.stick else terminal.HEADLINES[step.phase]
        self._markers.publish(drive_markers(
            *self._frames, *self._drive.picture(), self._config.radius_m, progress.known.points,
            f"{terminal.percent(progress.fraction).strip()}, {text}"))
        self._publish_state(step.phase, step.text, progress)

    def _publish_state(self, phase, text, progress=NO_PROGRESS):
        state = CalibrationState(
            phase=phase, text=text, fraction=progress.fraction, known=terminal.known_lines(progress.known),
            missing=terminal.missing_lines(progress.known.missing), driven=progress.driven_s, left=progress.left_s)
        state.stamp = self._clocks.ros_now()
        self._state.publish(state)

    def _announce(self, kind, lines, now_ns):
        """Draw lines over; where that can't be, print them when the kind changes, and now and then."""
        if self._text.is_live:
            self._text.show(terminal.wrapped(lines, self._text.width))
        elif kind != self._shown_kind or now_ns - self._shown_ns > PLAIN_PERIOD_NS:
            self._shown_kind, self._shown_ns = kind, now_ns
            self._text.say("\n".join(lines))

    def _say(self, *lines):
        """Print sentences that stay, wrapped to the terminal's width; whole where there is no terminal."""
        if lines:
            self._text.say("\n".join(terminal.wrapped(lines, self._text.width) if self._text.is_live else lines))

    def _ask_for(self, steering=0.0, speed_mps=0.0):
        """Ask for a steering and a speed, or to stand; by hand for nothing."""
        for publisher, value in zip(self._requests, (steering, speed_mps)):
            publisher.publish(Float32(value))

    def _stop_asking(self):
        """No request any more; the last one is to stand."""
        for speeds in self._requests[1:]:
            speeds.publish(Float32(0.0))
        self._requests = ()

    def _enter(self, stage, now_ns):
        self._stage, self._begun_ns = stage, now_ns

    # --- its end ---

    def _begin_end(self, text):
        self._ask_for()
        self._text.keep()
        self._text.say(text)
        self._publish_state(DONE, text, self._drive.progress())
        self._inbox.work(partial(conclude, self._drive.samples.drive(), self._base, self._table.base_text,
                                 os.path.basename(self._recording.path)), self._on_conclusion)
        # It asks to stand until the recording is closed: silence would be a fault of the drive on its page.
        self._stage = lambda now_ns, typed: self._ask_for()

    def _on_conclusion(self, conclusion, now_ns):
        self._say(*conclusion.report)
        # None: a person is asked.
        replaces = not self._table.path.exists() or self._wanted.yes or (None if self._has_keys else False)
        if conclusion.result is not None:
            steps = next_steps(self._table, conclusion.refusal, replaces)
            self._result.publish(String(conclusion.result._replace(next_steps=steps).text()))
        self._enter(self._await_page, now_ns)
        if conclusion.refusal:
            self._say(*terminal.missing_lines(conclusion.missing))
            why = terminal.REFUSED if conclusion.missing else conclusion.refusal
            self._refusal = f"no calibration is written: {why}"
        elif replaces is None:
            question = f"Replace {self._table.path}? The old one is kept beside it."
            self._announce("question", [question, "Y: yes, N: no"], now_ns)
            self._stage = partial(self._ask, conclusion)
        else:
            self._write(conclusion, replaces)

    def _ask(self, conclusion, now_ns, typed):
        self._close_recording(now_ns)
        answer = next((key for key in typed if key in "yn"), "")
        if answer:
            self._text.keep()
            self._write(conclusion, replaces=answer == "y")
            self._enter(self._await_page, now_ns)

    def _write(self, conclusion, replaces):
        lines = self._table.write(conclusion.yaml_text, replaces)
        self._is_written = True
        self._text.say("\n".join(lines))
        self._say(board_center(conclusion.result.centers,
                               self._inbox.graph.parameter("pca9685/steering/servo_center", None)))

    def _close_recording(self, now_ns):
        self._ask_for()
        if not self._recording.is_ending and now_ns - self._begun_ns >= RESULT_ARRIVES_NS:
            self._recording.end()
            self._stop_asking()

    def _await_page(self, now_ns, typed):
        self._close_recording(now_ns)
        lines = self._recording.report()
        if lines is None:
            self._announce("page", [f"makes the recording's page: {(now_ns - self._begun_ns) // NS_PER_S} s"], now_ns)
            if self._timer.ticks % TICKS_PER_SHOW == 0:
                self._publish_state(DONE, "it makes the recording's page")
            return
        self._text.show([])
        self._text.say("\n".join(lines))
        self._is_over = True
        self._inbox.end()
        if self._refusal:
            raise EndedEarly(self._refusal)


# --- what rviz shows ---


def drive_markers(odom_frame, base_frame, start, path, radius_m, points, text) -> MarkerArray:
    """Return the whole picture, which takes the place of the one before.

    Args:
        odom_frame, base_frame: odometry's frame, and the car's.
        start: the area's center in odometry's frame; ``None`` = it hasn't begun.
        path: where the car is about to go, (x, y) in odometry's frame.
        radius_m: the area's.
        points: of the tables by side: an arc each, from the car.
    """
    markers = no_markers(odom_frame).markers
    if start is not None:
        x_m, y_m = start
        angles = [2 * math.pi * index / CIRCLE_POINTS for index in range(CIRCLE_POINTS + 1)]
        circle = [(x_m + radius_m * math.cos(angle), y_m + radius_m * math.sin(angle)) for angle in angles]
        cross = [(x_m - CROSS_M, y_m), (x_m + CROSS_M, y_m), start, (x_m, y_m + CROSS_M), (x_m, y_m - CROSS_M)]
        markers += [_line("area", index, odom_frame, AREA, line) for index, line in enumerate((circle, cross))]
    if path:  # rviz reports a line of fewer points than two as an error
        markers.append(_line("path", 0, odom_frame, PATH, path, 2 * LINE_M))
    arcs = [(point, point.radius_m if side == "left" else -point.radius_m)
            for side, table in points.items() for point in table]
    markers += [_line("known", index, base_frame, COLORS[terminal.mark(point)], _arc(turn_m))
                for index, (point, turn_m) in enumerate(arcs) if point.radius_m <= WIDEST_M]
    label = marker("text", 0, base_frame, Marker.TEXT_VIEW_FACING, TEXT, Vector3(0.0, 0.0, TEXT_M),
                   Pose(Point(-BEHIND_M, 0.0, ABOVE_M), NO_ROTATION), text=textwrap.fill(text, TEXT_COLUMNS))
    return MarkerArray([*markers, label])


def no_markers(frame) -> MarkerArray:
    """Return a picture of nothing."""
    return MarkerArray([Marker(header=Header(frame_id=frame), action=Marker.DELETEALL)])


def _arc(radius_m):
    """Return points of an arc that the middle of the rear axle would drive, to the left for a radius above 0."""
    angle_rad = min(MAX_ARC_RAD, ARC_M / abs(radius_m))
    steps = [angle_rad * index / ARC_STEPS for index in range(ARC_STEPS + 1)]
    return [(abs(radius_m) * math.sin(step), radius_m * (1 - math.cos(step))) for step in steps]


def _line(ns, index, frame, color, points, width_m=LINE_M):
    return marker(ns, index, frame, Marker.LINE_STRIP, color, Vector3(width_m, 0.0, 0.0),
                  points=[Point(x_m, y_m, HEIGHT_M) for x_m, y_m in points])


def main():
    run(NAME, partial(CalibrationDriveNode, parse(rospy.myargv(sys.argv)[1:])))
