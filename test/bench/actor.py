#!/usr/bin/env python3
"""The other processes of a measurement, each by its role. Each prints "ready" when it is.

    relay IN OUT        publishes 16 duties for each Bool that it receives
    sink TOPIC FILE     writes the time of each message's arrival to a file, as the virtual chip does
    timer NAME...       subscribes to inputs and publishes 16 duties at 100 Hz, whatever the inputs are
    inputs NAME...      publishes human, steering, radius, odometry, acceleration, joy at 50 Hz. The deadman is first
                        released, until turn_arb has seen that; then nothing changes
    pipe PORT [RATE]    reads a serial port and publishes a ready-made teensy_wheel or teensy_distance for each frame;
                        with a RATE also odom, tf and joint_states at that rate, and a range with each teensy_distance
    line LINK           a serial line with captured wheel and sonar frames. On standard input "go 10" starts sending at
                        ten times 115200 baud, "stop" ends it and prints what was sent
    count [TOPIC...]    counts teensy_wheel and teensy_distance, and subscribes to the topics; "connected" prints when
                        both are connected, "report" prints the count since the last report
    drive SPEED [both]  drives a car in circles as gamepad and planner, with all its topics subscribed to; prints
                        "drives" when it does. With "both" the gamepad steers every other ten seconds, and e_stop is
                        published
"""
from __future__ import annotations

import itertools
import json
import os
import select
import signal
import sys
import termios
import threading
import time
import tty
from pathlib import Path

import rospy
from car_interface.msg import Control, Distance, Longitudinal, OneWheel, SteeringState, Wheel
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, Joy, Range
from std_msgs.msg import Bool, Float32, Int32MultiArray, MultiArrayDimension, MultiArrayLayout
from tf2_msgs.msg import TFMessage

PERIOD_S = 0.02
TIMER_NS = 10_000_000
DUTIES = Int32MultiArray(layout=MultiArrayLayout(dim=[MultiArrayDimension("pwm_channel", 16, 1)]), data=[5100] * 16)
BYTES_PER_S = 11_520  # 115200 baud, 8N1
WHEELS, SONAR = 7, 6  # the firmware's commands
MAX_SONAR_FRAME = 26  # bytes, each escaped
DATA = Path(__file__).resolve().parents[1] / "data"
RADIUS_M = 1.6  # as the demo drives
TURN_S = 10  # for which the gamepad, then the planner steers
SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")


def ready() -> None:
    print("ready", flush=True)


def publisher(topic, message_type):
    return rospy.Publisher(topic, message_type, queue_size=10, tcp_nodelay=True)


def at_50_hz(act) -> None:
    """Call a function until shutdown, without drift."""
    due_s = time.monotonic()
    while not rospy.is_shutdown():
        act()
        due_s += PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))


def relay(source, target):
    duties = publisher(target, Int32MultiArray)
    rospy.Subscriber(source, Bool, lambda message: duties.publish(DUTIES), queue_size=10, tcp_nodelay=True)
    ready()
    signal.pause()


def sink(topic, path):
    with open(path, "a", buffering=1, encoding="ascii") as file:
        rospy.Subscriber(topic, Int32MultiArray, lambda message: file.write(f"{time.monotonic_ns()}\n"),
                         queue_size=10, tcp_nodelay=True)
        ready()
        signal.pause()


def timer(*names):
    for name in names:
        rospy.Subscriber(*INPUTS[name][:2], lambda message: None, queue_size=10, tcp_nodelay=True)
    duties = publisher("/bench/timer", Int32MultiArray)
    ready()
    due_ns = time.monotonic_ns()
    while not rospy.is_shutdown():
        due_ns += TIMER_NS
        select.select([], [], [], max(0, due_ns - time.monotonic_ns()) / 1e9)
        duties.publish(DUTIES)


def control():
    return Control(stamp=rospy.Time.now(), longitudinal=Longitudinal(acceleration=0.5))


def odometry():
    message = Odometry()
    message.header.stamp = rospy.Time.now()
    message.twist.twist.linear.x = 1.0
    return message


def joy(autonomous=1, manual=0):
    return Joy(axes=[float(manual)] + [0.0] * 7, buttons=[0] * 4 + [manual, autonomous] + [0] * 5)


class Deadman:
    """Released until turn_arb has seen that: it does not accept one that is held at its start."""

    def __init__(self):
        self._released = 0  # states of turn_arb that report it

    @property
    def is_held(self):
        return self._released >= 3  # one on the change, and two a tenth of a second apart: inputs came in between

    def wait_for_turn_arb(self):
        states = rospy.Subscriber("turn_arb/state", SteeringState, self._on_state)
        while not self.is_held and not rospy.is_shutdown():
            time.sleep(0.01)
        states.unregister()  # a subscriber costs turn_arb CPU time

    def _on_state(self, state):
        self._released += state.reason == "human_in_loop is false"


DEADMAN = Deadman()
INPUTS = {
    "human": ("/teleop_logi/human_in_loop", Bool, lambda: DEADMAN.is_held),
    "steering": ("/teleop_logi/tele_steer_req", Float32, lambda: 0.3),
    "radius": ("/av_turnrad_req", Float32, lambda: 2.0),
    "acceleration": ("/control/command/control_cmd", Control, control),
    "odometry": ("/odom", Odometry, odometry),
    "joy": ("/joy", Joy, lambda: joy(int(DEADMAN.is_held))),
}


def inputs(*names):
    senders = [(publisher(*INPUTS[name][:2]).publish, INPUTS[name][2]) for name in names]
    threading.Thread(target=DEADMAN.wait_for_turn_arb, daemon=True).start()
    ready()
    at_50_hz(lambda: [publish(make()) for publish, make in senders])


class Measurements:
    """Publishes what a hub does besides the raw records, ready-made and as often, except what it does once a second."""

    def __init__(self, rate_hz):
        self._period_ns = round(1e9 / float(rate_hz))
        self._due_ns = 0
        self._odometry = [(publisher("odom", Odometry), Odometry()), (publisher("/tf", TFMessage), TFMessage(
            transforms=[TransformStamped()])), (publisher("joint_states", JointState), JointState(
                name=["rear_left_wheel", "rear_right_wheel"], position=[0.0, 0.0], velocity=[0.0, 0.0]))]
        self._ranges = itertools.cycle([publisher(f"sonar/{name}", Range) for name in SONARS])
        self._range = Range()

    def publish_odometry(self):
        now_ns = time.monotonic_ns()
        if now_ns >= self._due_ns:
            self._due_ns = max(self._due_ns + self._period_ns, now_ns)
            for topic, message in self._odometry:
                topic.publish(message)

    def publish_range(self):
        next(self._ranges).publish(self._range)


def pipe(port, rate_hz=None):
    """The longer frames are the wheels' reports."""
    wheel, distance = publisher("teensy_wheel", Wheel), publisher("teensy_distance", Distance)
    wheels, echo = Wheel(OneWheel(), OneWheel()), Distance(0, 1000, 0)
    measurements = Measurements(rate_hz) if rate_hz else None
    fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, termios.TCSANOW)
    ready()
    rest = b""
    while not rospy.is_shutdown():
        if not select.select([fd], [], [], 0.5)[0]:
            continue
        *frames, rest = (rest + os.read(fd, 4096)).split(b"\x7e")
        for frame in filter(None, frames):
            if len(frame) > MAX_SONAR_FRAME:
                wheel.publish(wheels)
                if measurements:
                    measurements.publish_odometry()
            else:
                distance.publish(echo)
                if measurements:
                    measurements.publish_range()


def captured(*commands):
    """Yield the capture's frames of these commands, each with both its flags."""
    capture = (DATA / "capture_mixed.bin").read_bytes()
    for text in (DATA / "capture_mixed.jsonl").read_text(encoding="utf-8").splitlines():
        frame = json.loads(text)
        if frame["cmd"] in commands:
            yield capture[frame["start"]:frame["end"] + 1]


class Line:
    """A pseudo-terminal at a link. When its reader is too slow bytes are lost, as on a real line."""

    def __init__(self, link):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        if os.path.islink(link):
            os.unlink(link)
        os.symlink(os.ttyname(self._far), link)
        self.lost_bytes = 0

    def send(self, data) -> None:
        try:
            self.lost_bytes += len(data) - os.write(self._near, data)
        except BlockingIOError:
            self.lost_bytes += len(data)

    def drain(self) -> None:
        """Discard what the reader wrote."""
        try:
            os.read(self._near, 4096)
        except BlockingIOError:
            pass


def line(link):
    terminal = Line(link)
    frames = list(captured(WHEELS, SONAR))
    going, order = threading.Event(), {}

    def read_commands():
        for text in sys.stdin:
            if text.strip() == "stop":
                going.clear()
                time.sleep(0.1)
                print("sent", order["frames"], terminal.lost_bytes, flush=True)
            else:
                terminal.lost_bytes = 0
                order.update(bytes_per_s=float(text.split()[1]) * BYTES_PER_S, frames=0)
                going.set()
    threading.Thread(target=read_commands, daemon=True).start()
    ready()
    index = 0
    while not rospy.is_shutdown():
        going.wait()
        due_s = time.monotonic()
        while going.is_set() and not rospy.is_shutdown():
            batch = b""
            while due_s <= time.monotonic():
                data = frames[index % len(frames)]
                index += 1
                batch += data
                order["frames"] += 1
                due_s += len(data) / order["bytes_per_s"]
            terminal.send(batch)
            terminal.drain()
            time.sleep(max(0.0, due_s - time.monotonic()))


def count(*topics):
    counts = [0]

    def count_one(_):
        counts[0] += 1
    subscribers = [rospy.Subscriber(topic, message_type, count_one, tcp_nodelay=True)
                   for topic, message_type in (("teensy_wheel", Wheel), ("teensy_distance", Distance))]
    for topic in topics:
        rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None, tcp_nodelay=True)
    ready()
    for text in sys.stdin:
        if text.strip() == "connected":
            while not all(subscriber.get_num_connections() for subscriber in subscribers):
                time.sleep(0.01)
            time.sleep(0.2)  # until the publishers have it too
            print("connected", flush=True)
        else:
            time.sleep(0.3)  # for messages in transit
            print("counted", counts[0], flush=True)
            counts[0] = 0


class Driver:
    """Holds the autonomous deadman and commands a circle at a speed; subscribes to what the demo's drive does."""

    def __init__(self, target_mps, alternates):
        self._target_mps = target_mps
        self._e_stop = publisher("e_stop", Bool) if alternates else None
        self._steers_s = 0.0  # when turn_arb last steered by gamepad or planner
        if alternates:
            rospy.Subscriber("turn_arb/state", SteeringState, self._on_steering)
        self._speed_mps = 0.0
        self._begun_s = time.monotonic()
        self._drives = False
        rospy.Subscriber("odom", Odometry, self._on_odometry)
        for topic in ("car_sim/truth", "turn_arb/state", "servo/output", "servo/cmdVector", "teensy_wheel",
                      "teensy_distance", "teensy_pong", "teensy_clock", "teensy_error", "teensy_sensor_hub/link",
                      "throttle_arb/state", "teleop_logi/human_in_loop", "teleop_logi/tele_steer_req",
                      "teleop_logi/tele_throt_req",
                      "generic/output/value", *(f"sonar/{name}" for name in SONARS)):
            rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None)
        self._joy, self._radius = publisher("joy", Joy), publisher("av_turnrad_req", Float32)
        self._commands = publisher("control/command/control_cmd", Control)

    def _on_odometry(self, message):
        self._speed_mps = message.twist.twist.linear.x

    def _on_steering(self, state):
        if state.source in (SteeringState.TELEOP, SteeringState.PLANNER):
            self._steers_s = time.monotonic()

    def publish(self):
        """Publish all inputs. Until the car drives the deadman is released and held every three seconds: topics connect
        in any order.
        """
        passed_s = time.monotonic() - self._begun_s
        must_rearm = not self._drives or self._e_stop and time.monotonic() - self._steers_s > 3
        held = int(not must_rearm or passed_s % 3 > 0.3)
        manual = held if self._e_stop and passed_s % (2 * TURN_S) > TURN_S else 0
        self._joy.publish(joy(held - manual, manual))
        if self._e_stop:
            self._e_stop.publish(False)
        self._radius.publish(RADIUS_M)
        acceleration = max(-2.0, min(2.0, 1.5 * (self._target_mps - self._speed_mps)))
        self._commands.publish(Control(stamp=rospy.Time.now(), longitudinal=Longitudinal(acceleration=acceleration)))
        if not self._drives and self._speed_mps > 0.9 * self._target_mps:
            self._drives = True
            print("drives", flush=True)


def drive(speed_mps, alternates=""):
    driver = Driver(float(speed_mps), alternates == "both")
    ready()
    at_50_hz(driver.publish)


ROLES = {role.__name__: role for role in (relay, sink, timer, inputs, pipe, line, count, drive)}

if __name__ == "__main__":
    arguments = rospy.myargv()[1:]
    # rospy's own handler swallows an interrupt while standard input is read.
    rospy.init_node(f"bench_{arguments[0]}", anonymous=True, disable_signals=True)
    sys.setswitchinterval(0.0005)  # as the package's nodes
    try:
        ROLES[arguments[0]](*arguments[1:])
    except (rospy.ROSException, KeyboardInterrupt):
        pass  # shutdown
    rospy.signal_shutdown("ended")
