"""The demo_drive node: drives the virtual car by a script over the real topics, and checks the result.

It simulates the human (joy) and the planner (av_turnrad_req, control commands), prints a status line while it drives,
and ends with a table. Exit code 0 only if all checks pass.

Publishes:
    joy (sensor_msgs/Joy), av_turnrad_req (std_msgs/Float32), control/command/control_cmd (Control): each at 50 Hz.
Subscribes to the topics of the car's nodes.
Parameters:
    ~bag_dir: absolute path of a folder for a bag of all topics; none = no recording.
    ~esc, ~gamepad, ~wheels: what throttle.yaml, teleop_logi.yaml and teensy_sensor_hub.yaml of the car say, as
        demo.launch loads them: the ESC's channel, the gamepad's axis and buttons, and the wheels' sizes and pulses.
    It also reads those of turn_arb: how far to push the stick for the human's circle, and the steering's channel.
"""
from __future__ import annotations

import math
import sys
from collections import Counter
from dataclasses import dataclass

from car_interface.msg import (
    Control,
    Distance,
    Error,
    Float64Stamped,
    LinkStatus,
    Longitudinal,
    Pong,
    SteeringState,
    TeensyClock,
    ThrottleState,
    Wheel,
)
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy, Range
from std_msgs.msg import Bool, Float32, Int32MultiArray

from car_interface.common.errors import CarInterfaceError, EndedEarly
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import NO_HUMAN, PLANNER, SOURCE_NAMES
from car_interface.common.sources import TELEOP as TELEOP_STEERS
from car_interface.common.units import CHANNELS, NS_PER_S, yaw_rad
from car_interface.common.vehicle_geometry import SONARS
from car_interface.nodes.bag_recording import BagRecording
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.steering.calibration import SteeringCalibration
from car_interface.steering.config import calibration_of
from demo_script import (
    DONE,
    LEFT_CIRCLE,
    LET_GO,
    NOBODY,
    RIGHT_CIRCLE,
    STAGE_NAMES,
    TELEOP,
    TURN_RAD,
    Drive,
    DriveConfig,
)

RATE_HZ = 50
HUMAN_RADIUS_M = 1.75  # around the post in the middle of the room's left half
READY_WITHIN_S = 30
STILL_S = 0.1  # a drive that was held up for longer may fail for this reason alone
LINE_PERIOD_S = 0.1 if sys.stdout.isatty() else 2.0
AXES, BUTTONS, MAX_INDEX = 8, 11, 63
# After a change of stage the source isn't checked: mode and stick arrive on different topics, and an old stick
# overrides the planner for 0.5 s.
SETTLING_NS = NS_PER_S
# Tolerance of odometry at the end, after some 34 m: as a ratio of the distance; and of the angle by which the car turns
# when one wheel goes on by a pulse, 2.9 degrees with the shipped wheels. Between two pulses the place is unknown: at
# either end of the drive each of the two wheels may be off by half of one, together by two.
ODOMETRY_RATIO, PULSE_RATIO = 0.01, 2.0


class Watch:
    """Records what the checks use."""

    def __init__(self, steering_channel, throttle_channel):
        self._steering_channel, self._throttle_channel = steering_channel, throttle_channel
        self.messages = Counter()
        self.pose = self.state = self.output = self.link = self.odometry = None
        self.yaw_rad = self.speed_mps = self.distance_m = 0.0
        self.stage, self.stage_since_ns = NOBODY, 0
        self.stage_distance_m = Counter()
        self.stage_sources = {stage: set() for stage in range(DONE + 1)}
        self.stage_drivers = {stage: set() for stage in range(DONE + 1)}
        self.stopped_by = {}  # the reason of the first state in which nobody drove, by stage and type
        self.throttle_state = None
        self.stage_yaw_rad = Counter()
        self.sonar_m = {}
        self.rest = None  # the servo board's output before the drive
        self._push = 0  # of the ESC's duty from there, added up over the drive: its sign is forward
        self.let_go_ns = self.neutral_ns = None

    def on_truth(self, message, now_ns):
        """Take the true pose of the car."""
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        if self.pose is not None:
            distance_m = math.hypot(position.x - self.pose[0], position.y - self.pose[1])
            self.distance_m += distance_m
            self.stage_distance_m[self.stage] += distance_m
        self.pose = (position.x, position.y)
        self.yaw_rad = yaw_rad(orientation)
        self.speed_mps = message.twist.twist.linear.x

    def on_state(self, message, now_ns):
        """Take turn_arb's state."""
        self.state = message
        self._count(self.stage_sources, message, now_ns)

    def on_throttle_state(self, message, now_ns):
        """Take throttle_arb's state."""
        self.throttle_state = message
        self._count(self.stage_drivers, message, now_ns)

    def _count(self, stage_sources, message, now_ns):
        if now_ns - self.stage_since_ns > SETTLING_NS:
            stage_sources[self.stage].add(message.source)
            if message.source not in (TELEOP_STEERS, PLANNER):
                self.stopped_by.setdefault((self.stage, type(message)), message.reason)

    def on_output(self, message, now_ns):
        """Take the servo board's output."""
        self.output = message.data
        driven = self.duties
        if self.stage == NOBODY:
            self.rest = driven
        elif self.let_go_ns is None:
            self._push += driven[1] - self.rest[1]
        elif self.neutral_ns is None and driven[0] == self.rest[0] and (driven[1] - self.rest[1]) * self._push <= 0:
            self.neutral_ns = now_ns  # or it brakes

    def on_odometry(self, message, now_ns):
        """Take the pose by odometry."""
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        self.odometry = (position.x, position.y, yaw_rad(orientation))

    def on_range(self, message, now_ns):
        """Take a sonar's range; infinite: no echo."""
        self.sonar_m[message.header.frame_id] = message.range

    def on_link(self, message, now_ns):
        """Take the state of the serial link."""
        self.link = message

    def odometry_error(self):
        """Return the error of odometry, in m and degrees."""
        x_m, y_m, by_wheels_rad = self.odometry
        error_rad = math.remainder(by_wheels_rad - self.yaw_rad, 2 * math.pi)
        return math.hypot(x_m - self.pose[0], y_m - self.pose[1]), abs(math.degrees(error_rad))

    @property
    def duties(self):
        """The servo board's output for steering and ESC."""
        return self.output[self._steering_channel], self.output[self._throttle_channel]

    def missing(self):
        """Return the topics without a message so far; empty when the car is ready."""
        seen = {
            "car_sim/truth": self.pose,
            "turn_arb/state": self.state,
            "throttle_arb/state": self.throttle_state,
            "/servo/output": self.output and self.duties[0] >= 0,
            "odom": self.odometry,
            "the Teensy's link": self.link and self.link.pongs,
        }
        return [name for name, thing in seen.items() if not thing]


@dataclass(frozen=True)
class DemoDriveConfig:
    """The node's parameters.

    Attributes:
        bag_dir: where a bag is recorded; ``None`` = nowhere.
        throttle_channel: of the servo board.
        steer_axis, throttle_axis, manual_button, autonomous_button: of the gamepad that it plays.
        steer_scale, throttle_scale: the car's factors of the axes; −1 inverts one.
        pulse_deg: by how much a pulse of one wheel turns the car.
    """

    bag_dir: str | None
    throttle_channel: int
    steer_axis: int
    throttle_axis: int
    manual_button: int
    autonomous_button: int
    steer_scale: float
    throttle_scale: float
    pulse_deg: float


def read_config(params) -> DemoDriveConfig:
    """Read the node's configuration from its parameters, without side effects.

    Raises:
        ConfigError: naming the parameter.
    """
    pulse_m = (math.pi * params.number("wheels/wheel_diameter", 0.095, above=0.0)
               / params.integer("wheels/pulses_per_revolution", 20, 1))
    config = DemoDriveConfig(
        bag_dir=params.path("bag_dir", None),
        throttle_channel=params.integer("esc/servo/channel", 1, 0, CHANNELS - 1),
        steer_axis=params.integer("gamepad/steer_axis", 0, 0, MAX_INDEX),
        throttle_axis=params.integer("gamepad/throttle_axis", 4, 0, MAX_INDEX),
        manual_button=params.integer("gamepad/manual_button", 4, 0, MAX_INDEX),
        autonomous_button=params.integer("gamepad/autonomous_button", 5, 0, MAX_INDEX),
        steer_scale=params.number("gamepad/steer_scale", 1.0, -1.0, 1.0) or 1.0,
        throttle_scale=params.number("gamepad/throttle_scale", 1.0, -1.0, 1.0) or 1.0,
        pulse_deg=math.degrees(pulse_m / params.number("wheels/track", 0.296, above=0.0)))
    params.finish(ignored_namespaces=("esc", "gamepad", "wheels"))
    return config


def stick_for(radius_m: float, calibration: SteeringCalibration) -> float:
    """Return how far to push the stick for a turn of that radius, right negative: the inverse of ``teleop_duty``."""
    end = calibration.servo_left if radius_m > 0 else calibration.servo_right
    ratio = (calibration.planner_duty(radius_m) - calibration.servo_center) / (end - calibration.servo_center)
    return math.copysign(ratio, radius_m)


class DemoDrive:
    """Runs the script and checks the result."""

    def __init__(self, params, inbox):
        config = self._config = read_config(params)
        bag_dir = config.bag_dir
        self._inbox = inbox
        self._calibration = calibration_of(inbox.graph.parameter("turn_arb", {}))
        self._watch = Watch(self._calibration.servo_channel, config.throttle_channel)
        self._drive = None
        self._yaw_rad = 0.0
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._started_ns = now_ns
        self._stepped_ns, self._longest_step_ns = now_ns, 0
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._line_timer = RateTimer(1 / LINE_PERIOD_S, now_ns)
        self._joy = advertise("joy", Joy, inbox)
        self._radius = advertise("av_turnrad_req", Float32, inbox)
        self._control = advertise("control/command/control_cmd", Control, inbox)
        self._recording = BagRecording(bag_dir) if bag_dir else None
        self._watch_topics()

    def _watch_topics(self):
        watch = self._watch
        for topic, message_type, handler in (
                ("car_sim/truth", Odometry, watch.on_truth), ("turn_arb/state", SteeringState, watch.on_state),
                ("throttle_arb/state", ThrottleState, watch.on_throttle_state),
                ("/servo/output", Int32MultiArray, watch.on_output), ("odom", Odometry, watch.on_odometry),
                *((f"sonar/{name}", Range, watch.on_range) for name in SONARS),
                ("teensy_sensor_hub/link", LinkStatus, watch.on_link), ("teensy_wheel", Wheel, None),
                ("teensy_distance", Distance, None), ("teensy_pong", Pong, None), ("teensy_clock", TeensyClock, None),
                ("teensy_error", Error, None),
                ("/servo/cmdVector", Int32MultiArray, None), ("/teleop_logi/human_in_loop", Bool, None),
                ("/teleop_logi/tele_steer_req", Float32, None), ("/teleop_logi/tele_throt_req", Float32, None),
                ("generic/output/value", Float64Stamped, None)):
            watch.messages[topic] = 0
            subscribe(topic, message_type, self._inbox, self._counted(topic, handler), queue_size=100)

    def _counted(self, topic, handler):
        def count(message, now_ns):
            self._watch.messages[topic] += 1
            if handler is not None:
                handler(message, now_ns)
        return count

    def step(self, now_ns):
        """Handle what arrived; then the timers."""
        self._inbox.dispatch()
        if self._drive is None:
            self._wait_until_ready(now_ns)
        else:
            self._longest_step_ns = max(self._longest_step_ns, now_ns - self._stepped_ns)
            if self._timer.is_due(now_ns):
                self._order(now_ns)
        self._stepped_ns = now_ns
        if self._drive is not None and self._line_timer.is_due(now_ns):
            self._show(now_ns)
        return self._timer.due_ns if self._drive is not None else now_ns + NS_PER_S // 10

    def shut_down(self):
        """Close the bag; a drive that was interrupted has failed."""
        if self._recording is not None:
            self._recording.stop()
        if (self._drive is None or self._drive.stage != DONE) and sys.exc_info()[0] is None:
            print(flush=True)  # end the status line before the log line
            raise EndedEarly("the drive was ended before it was over")

    def _wait_until_ready(self, now_ns):
        missing = self._watch.missing()
        recording = self._recording
        if not missing and recording and not recording.has_subscribed(self._inbox.resolve_name("teensy_clock")):
            missing = ["the recorder of the bag"]
        if not missing:
            self._drive = Drive(DriveConfig(teleop_steering=stick_for(HUMAN_RADIUS_M, self._calibration)), now_ns)
            self._started_ns = now_ns
            self._watch.messages.update(dict.fromkeys(self._watch.messages, 0))
        elif now_ns - self._started_ns > READY_WITHIN_S * NS_PER_S:
            raise CarInterfaceError(f"the car isn't ready: nothing from {', '.join(missing)}")

    def _order(self, now_ns):
        watch, drive = self._watch, self._drive
        orders = drive.orders(now_ns, watch.yaw_rad, watch.speed_mps)
        if orders.stage != watch.stage:
            self._print_line(now_ns, end="\n")
            watch.stage_yaw_rad[watch.stage] = self._yaw_rad
            watch.stage, watch.stage_since_ns = orders.stage, now_ns
        self._yaw_rad = drive.turned_rad
        if orders.stage == DONE:
            self._finish()
            return
        if orders.gamepad_on:
            self._publish_joy(orders)
        if orders.stage == LET_GO and watch.let_go_ns is None:
            watch.let_go_ns = now_ns
        self._radius.publish(orders.radius_m)
        self._control.publish(Control(
            stamp=self._clocks.ros_now(), longitudinal=Longitudinal(acceleration=orders.acceleration_mps2)))

    def _publish_joy(self, orders):
        config = self._config
        message = Joy(axes=[0.0] * max(AXES, config.steer_axis + 1, config.throttle_axis + 1),
                      buttons=[0] * max(BUTTONS, config.manual_button + 1, config.autonomous_button + 1))
        message.header.stamp = self._clocks.ros_now()
        message.axes[config.steer_axis] = max(-1.0, min(1.0, orders.steering / config.steer_scale))
        message.axes[config.throttle_axis] = max(-1.0, min(1.0, orders.throttle / config.throttle_scale))
        message.buttons[config.manual_button] = int(orders.manual)
        message.buttons[config.autonomous_button] = int(orders.autonomous)
        self._joy.publish(message)

    def _show(self, now_ns):
        self._print_line(now_ns, end="" if sys.stdout.isatty() else "\n")

    def _print_line(self, now_ns, end):
        watch = self._watch
        nearest_m = min(watch.sonar_m.values(), default=math.inf)
        nearest = f"{nearest_m:4.2f} m" if nearest_m < math.inf else "free"
        text = (f"{(now_ns - self._started_ns) / NS_PER_S:5.1f} s  {STAGE_NAMES[watch.stage]:<21} "
                f"{SOURCE_NAMES[watch.state.source]:<8} "
                f"steering {watch.duties[0]:5d}  ESC {watch.duties[1]:5d}  "
                f"{watch.speed_mps:5.2f} m/s  at {watch.pose[0]:+5.2f} {watch.pose[1]:+5.2f}  nearest {nearest}")
        print(("\r\x1b[K" if sys.stdout.isatty() else "") + text, end=end, flush=True)

    def _finish(self):
        self._inbox.end()
        bag = self._recording.stop() if self._recording is not None else None
        watch = self._watch
        print("\nmessages per topic")
        for topic, count in sorted(watch.messages.items()):
            print(f"  {topic:<32} {count:6d}")
        print("the drive")
        for name, figure in self._figures(bag):
            print(f"  {name:<32} {figure}")
        failures = [text for text, passed in self._checks() if not passed]
        print("as planned: " + ("yes" if not failures else "no"), flush=True)
        if failures and self._longest_step_ns > STILL_S * NS_PER_S:
            failures.append(f"this computer stood still for {self._longest_step_ns / NS_PER_S:.1f} s meanwhile, which "
                            "a car takes for a person who is gone: end other programs, and start the demo again")
        if failures:
            raise CarInterfaceError("the drive didn't go as planned: " + "; ".join(failures))

    def _figures(self, bag):
        watch, link = self._watch, self._watch.link
        error_m, error_deg = watch.odometry_error()
        yield "distance driven", f"{watch.distance_m:.2f} m"
        yield "odometry at the end is off by", f"{error_m:.3f} m, {error_deg:.1f} degrees"
        yield "pings answered", f"{link.pongs} of {link.pings}"
        yield "frames good, bad", f"{link.frames}, {link.bad_frames + link.malformed_frames}"
        neutral = "never" if watch.neutral_ns is None else f"after {self._neutral_after_s() * 1e3:.1f} ms"
        yield "human let go, neutral or braking", neutral
        if bag:
            yield "bag", bag

    def _neutral_after_s(self):
        return (self._watch.neutral_ns - self._watch.let_go_ns) / NS_PER_S

    def _checks(self):
        """Yield what is wrong if a check fails, and whether it passed."""
        watch, link = self._watch, self._watch.link
        yaw_rad, sources, distance_m = watch.stage_yaw_rad, watch.stage_sources, watch.stage_distance_m
        yield "the car moved though nobody was there", distance_m[NOBODY] < 0.01
        yield "somebody steered though nobody was there", sources[NOBODY] == {NO_HUMAN}
        drivers, human, circles = watch.stage_drivers, (TELEOP,), (LEFT_CIRCLE, RIGHT_CIRCLE)

        def paused(who, stages, kind):
            reason = next((watch.stopped_by[stage, kind] for stage in stages if (stage, kind) in watch.stopped_by), "")
            return f"the {who} all the time" + (f" ({reason})" if reason else "")
        yield paused("human didn't steer", human, SteeringState), sources[TELEOP] == {TELEOP_STEERS}
        yield paused("human didn't drive", human, ThrottleState), drivers[TELEOP] == {TELEOP_STEERS}
        yield "the human's circle wasn't closed", yaw_rad[TELEOP] > 0.95 * TURN_RAD
        yield (paused("planner didn't steer", circles, SteeringState),
               sources[LEFT_CIRCLE] == sources[RIGHT_CIRCLE] == {PLANNER})
        yield (paused("planner didn't drive", circles, ThrottleState),
               drivers[LEFT_CIRCLE] == drivers[RIGHT_CIRCLE] == {PLANNER})
        yield "the left circle wasn't closed", yaw_rad[LEFT_CIRCLE] > 0.95 * TURN_RAD
        yield "the right circle wasn't closed", yaw_rad[RIGHT_CIRCLE] < -0.95 * TURN_RAD
        yield "the outputs weren't neutral within 0.1 s of letting go, nor did it brake", (
            watch.neutral_ns is not None and self._neutral_after_s() < 0.1)
        yield "the car rolled on after the human let go", abs(watch.speed_mps) < 0.05
        error_m, error_deg = watch.odometry_error()
        yield "odometry lost its way", (error_m < ODOMETRY_RATIO * watch.distance_m
                                        and error_deg < PULSE_RATIO * self._config.pulse_deg)
        yield "not every sonar was heard", len(watch.sonar_m) == len(SONARS)
        yield "pings went unanswered", link.pongs >= link.pings - 1
        yield "there were bad frames", link.bad_frames + link.malformed_frames == 0


def main():
    """Run the node, or print how it is used."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(__doc__)
    else:
        run("demo_drive", DemoDrive)
