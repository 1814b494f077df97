#!/usr/bin/env python3
"""Whoever else takes part in a measurement, each a process of its own; one line "ready" on standard output.

    relay IN OUT                passes a Bool on as 16 duties: two hops with whoever sends and listens
    sink TOPIC FILE             notes in a file when something arrived: as the virtual chip does
    beat NAME...                hears inputs and publishes 16 duties at 100 Hz, whatever it hears: a bare heartbeat
    inputs NAME...              publishes human, steering, radius, odometry, acceleration, joy at 50 Hz, never changing
                                once turn_arb has heard that nobody holds the deadman, and it's held
    pipe PORT [RATE]            reads a serial port; for each frame a ready-made teensy_wheel or teensy_distance; with a
                                RATE also odom, tf and joint_states so often, and a range with each teensy_distance
    line LINK                   a serial line with captured wheel and sonar frames: "go 10" on standard input has it
                                send at ten times 115200 baud, "stop" has it say what it has sent since
    count [TOPIC...]            counts teensy_wheel and teensy_distance, and hears the rest; "connected" says when both
                                are, "report" prints the sum since the last report
    drive SPEED                 drives a car in circles: gamepad, planner, and whoever listens; says when it "drives"
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
BEAT_NS = 10_000_000
DUTIES = Int32MultiArray(layout=MultiArrayLayout(dim=[MultiArrayDimension("pwm_channel", 16, 1)]), data=[5100] * 16)
BYTES_PER_S = 11_520  # 115200 baud, 8N1
WHEELS, SONAR = 7, 6  # the firmware's commands
LONGEST_SONAR_FRAME = 26  # bytes, each escaped
DATA = Path(__file__).resolve().parents[1] / "data"
RADIUS_M = 1.6  # as the demo drives
SONARS = ("front_right", "front_middle", "front_left", "rear_right", "rear_middle", "rear_left")


def ready() -> None:
    print("ready", flush=True)


def publisher(topic, message_type):
    return rospy.Publisher(topic, message_type, queue_size=10, tcp_nodelay=True)


def at_50_hz(act) -> None:
    """For ever, on a grid."""
    due_s = time.monotonic()
    while not rospy.is_shutdown():
        act()
        due_s += PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))


def relay(heard, said):
    duties = publisher(said, Int32MultiArray)
    rospy.Subscriber(heard, Bool, lambda message: duties.publish(DUTIES), queue_size=10, tcp_nodelay=True)
    ready()
    signal.pause()


def sink(topic, path):
    with open(path, "a", buffering=1, encoding="ascii") as file:
        rospy.Subscriber(topic, Int32MultiArray, lambda message: file.write(f"{time.monotonic_ns()}\n"),
                         queue_size=10, tcp_nodelay=True)
        ready()
        signal.pause()


def beat(*names):
    for name in names:
        rospy.Subscriber(*INPUTS[name][:2], lambda message: None, queue_size=10, tcp_nodelay=True)
    duties = publisher("/bench/beat", Int32MultiArray)
    ready()
    due_ns = time.monotonic_ns()
    while not rospy.is_shutdown():
        due_ns += BEAT_NS
        select.select([], [], [], max(0, due_ns - time.monotonic_ns()) / 1e9)
        duties.publish(DUTIES)


def control():
    return Control(stamp=rospy.Time.now(), longitudinal=Longitudinal(acceleration=0.5))


def odometry():
    message = Odometry()
    message.header.stamp = rospy.Time.now()
    message.twist.twist.linear.x = 1.0
    return message


def joy(autonomous=1):
    return Joy(axes=[0.0] * 8, buttons=[0] * 5 + [autonomous] + [0] * 5)


class Deadman:
    """Let go until turn_arb has heard so, and counts it: what is held at its start counts for nothing."""

    def __init__(self):
        self._heard = 0

    @property
    def is_held(self):
        return self._heard >= 3  # one on the change, and two a tenth of a second apart: others came in between

    def wait_for_turn_arb(self):
        states = rospy.Subscriber("turn_arb/state", SteeringState, self._hear)
        while not self.is_held and not rospy.is_shutdown():
            time.sleep(0.01)
        states.unregister()  # it would cost turn_arb something

    def _hear(self, state):
        self._heard += state.reason == "human_in_loop is false"


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
    publish = [(publisher(*INPUTS[name][:2]).publish, INPUTS[name][2]) for name in names]
    threading.Thread(target=DEADMAN.wait_for_turn_arb, daemon=True).start()
    ready()
    at_50_hz(lambda: [say(make()) for say, make in publish])


class Measured:
    """What a hub says besides the raw records, ready-made, as often; without what comes once a second."""

    def __init__(self, rate_hz):
        self._period_ns = round(1e9 / float(rate_hz))
        self._due_ns = 0
        self._moved = [(publisher("odom", Odometry), Odometry()), (publisher("/tf", TFMessage), TFMessage(
            transforms=[TransformStamped()])), (publisher("joint_states", JointState), JointState(
                name=["rear_left_wheel", "rear_right_wheel"], position=[0.0, 0.0], velocity=[0.0, 0.0]))]
        self._ranges = itertools.cycle([publisher(f"sonar/{name}", Range) for name in SONARS])
        self._range = Range()

    def wheels(self):
        now_ns = time.monotonic_ns()
        if now_ns >= self._due_ns:
            self._due_ns = max(self._due_ns + self._period_ns, now_ns)
            for topic, message in self._moved:
                topic.publish(message)

    def sonar(self):
        next(self._ranges).publish(self._range)


def pipe(port, rate_hz=None):
    """What is long is a report of the wheels."""
    wheel, distance = publisher("teensy_wheel", Wheel), publisher("teensy_distance", Distance)
    wheels, echo = Wheel(OneWheel(), OneWheel()), Distance(0, 1000, 0)
    measured = Measured(rate_hz) if rate_hz else None
    fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, termios.TCSANOW)
    ready()
    rest = b""
    while not rospy.is_shutdown():
        if not select.select([fd], [], [], 0.5)[0]:
            continue
        *frames, rest = (rest + os.read(fd, 4096)).split(b"\x7e")
        for frame in filter(None, frames):
            if len(frame) > LONGEST_SONAR_FRAME:
                wheel.publish(wheels)
                if measured:
                    measured.wheels()
            else:
                distance.publish(echo)
                if measured:
                    measured.sonar()


def captured(*commands):
    """The golden capture's frames of these kinds, each with both its flags."""
    capture = (DATA / "capture_mixed.bin").read_bytes()
    for text in (DATA / "capture_mixed.jsonl").read_text(encoding="utf-8").splitlines():
        frame = json.loads(text)
        if frame["cmd"] in commands:
            yield capture[frame["start"]:frame["end"] + 1]


class Line:
    """A pseudo-terminal at a link. What a reader is too slow for is lost, as on a real line."""

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
        """Take what the reader wrote, and drop it."""
        try:
            os.read(self._near, 4096)
        except BlockingIOError:
            pass


def line(link):
    terminal = Line(link)
    frames = list(captured(WHEELS, SONAR))
    going, order = threading.Event(), {}

    def obey():
        for text in sys.stdin:
            if text.strip() == "stop":
                going.clear()
                time.sleep(0.1)
                print("sent", order["frames"], terminal.lost_bytes, flush=True)
            else:
                terminal.lost_bytes = 0
                order.update(bytes_per_s=float(text.split()[1]) * BYTES_PER_S, frames=0)
                going.set()
    threading.Thread(target=obey, daemon=True).start()
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
            time.sleep(0.2)  # and the publisher's side has it too
            print("connected", flush=True)
        else:
            time.sleep(0.3)  # what is on its way
            print("counted", counts[0], flush=True)
            counts[0] = 0


class Driver:
    """The autonomous deadman held, a circle, a speed that is kept; hears what the demo's drive hears."""

    def __init__(self, wanted_mps):
        self._wanted_mps = wanted_mps
        self._speed_mps = 0.0
        self._begun_s = time.monotonic()
        self._drives = False
        rospy.Subscriber("odom", Odometry, self._on_odometry)
        for topic in ("car_sim/truth", "turn_arb/state", "servo/output", "servo/cmdVector", "teensy_wheel",
                      "teensy_distance", "teensy_pong", "teensy_clock", "teensy_error", "teensy_sensor_hub/link",
                      "teleop_logi/human_in_loop", "teleop_logi/tele_steer_req", "teleop_logi/tele_throt_req",
                      "generic/output/value", *(f"sonar/{name}" for name in SONARS)):
            rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None)
        self._joy, self._radius = publisher("joy", Joy), publisher("av_turnrad_req", Float32)
        self._commands = publisher("control/command/control_cmd", Control)

    def _on_odometry(self, message):
        self._speed_mps = message.twist.twist.linear.x

    def order(self):
        """The deadman is held anew every three seconds until the car drives: topics come in any order."""
        passed_s = time.monotonic() - self._begun_s
        self._joy.publish(joy(int(self._drives or passed_s % 3 > 0.3)))
        self._radius.publish(RADIUS_M)
        wanted = max(-2.0, min(2.0, 1.5 * (self._wanted_mps - self._speed_mps)))
        self._commands.publish(Control(stamp=rospy.Time.now(), longitudinal=Longitudinal(acceleration=wanted)))
        if not self._drives and self._speed_mps > 0.9 * self._wanted_mps:
            self._drives = True
            print("drives", flush=True)


def drive(speed_mps):
    driver = Driver(float(speed_mps))
    ready()
    at_50_hz(driver.order)


ROLES = {role.__name__: role for role in (relay, sink, beat, inputs, pipe, line, count, drive)}

if __name__ == "__main__":
    arguments = rospy.myargv()[1:]
    # rospy's own handler swallows an interrupt while standard input is read.
    rospy.init_node(f"bench_{arguments[0]}", anonymous=True, disable_signals=True)
    sys.setswitchinterval(0.0005)  # as the package's nodes
    try:
        ROLES[arguments[0]](*arguments[1:])
    except (rospy.ROSException, KeyboardInterrupt):
        pass  # it ends
    rospy.signal_shutdown("ended")
