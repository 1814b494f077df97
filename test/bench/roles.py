"""The other processes of a measurement, each by its role. Each prints "ready" when it is.

    relay IN OUT NAME...  publishes 16 duties for each Bool that it receives; subscribes to inputs, too
    sink TOPIC FILE     writes the time of each message's arrival to a file, as the virtual chip does
    timer RATE NAME...  subscribes to inputs and publishes 16 duties at that rate, whatever the inputs are
    inputs ARBITERS NAME...
                        publishes these of inputs.INPUTS. The deadman is first released, until the arbiters (none, or
                        with a comma between) have seen that; then nothing changes
    board [TOPIC...]    answers /servo/cmdVector by /servo/output, on a change and at 10 Hz, as the servo board;
                        receives the same of other topics
    pipe PORT [RATE]    reads a serial port and publishes a ready-made teensy_wheel or teensy_distance for each frame;
                        with a RATE also odom, tf and joint_states at that rate, and a range with each teensy_distance
    line LINK           a serial line with captured wheel and sonar frames. On standard input "go 10" starts sending at
                        ten times 115200 baud, "stop" ends it and prints what was sent
    count [TOPIC...]    counts teensy_wheel and teensy_distance, and subscribes to the topics; "connected" prints when
                        both are connected, "report" prints the count since the last report
    drive SPEED [both] [cmd_vel]
                        drives a car in circles as gamepad and planner, with all its topics subscribed to; prints
                        "drives" when it does. With "both" the gamepad steers every other ten seconds, and e_stop is
                        published; with "cmd_vel" the planner drives by planner_interface
"""
from __future__ import annotations

import itertools
import os
import select
import signal
import sys
import termios
import threading
import time
import tty

import rospy
from car_interface.msg import Distance, OneWheel, Wheel
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Bool, Int32MultiArray
from tf2_msgs.msg import TFMessage

from .capture import MAX_SONAR_FRAME, SONAR, WHEELS, Line, captured
from .driver import SONARS, Driver
from .inputs import DUTIES, INPUTS, Deadman, publisher

PERIOD_S = 0.02
NEUTRAL = 4915  # of the ESC, config/throttle.yaml: the board holds it from the start


def ready() -> None:
    print("ready", flush=True)


def ignore(topic, message_type=rospy.AnyMsg) -> None:
    rospy.Subscriber(topic, message_type, lambda message: None, queue_size=10, tcp_nodelay=True)


def ignore_inputs(names) -> None:
    for name in names:
        ignore(*INPUTS[name][:2])


def at_50_hz(act) -> None:
    due_s = time.monotonic()
    while not rospy.is_shutdown():
        act()
        due_s += PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))


def relay(source, target, *names):
    duties = publisher(target, Int32MultiArray)
    ignore_inputs(names)
    rospy.Subscriber(source, Bool, lambda message: duties.publish(DUTIES), queue_size=10, tcp_nodelay=True)
    ready()
    signal.pause()


def sink(topic, path):
    with open(path, "a", buffering=1, encoding="ascii") as file:
        rospy.Subscriber(topic, Int32MultiArray, lambda message: file.write(f"{time.monotonic_ns()}\n"),
                         queue_size=10, tcp_nodelay=True)
        ready()
        signal.pause()


def timer(rate_hz, *names):
    ignore_inputs(names)
    duties = publisher("/bench/timer", Int32MultiArray)
    ready()
    period_ns, due_ns = round(1e9 / float(rate_hz)), time.monotonic_ns()
    while not rospy.is_shutdown():
        due_ns += period_ns
        select.select([], [], [], max(0, due_ns - time.monotonic_ns()) / 1e9)
        duties.publish(DUTIES)


def inputs(arbiters, *names):
    deadman = Deadman(() if arbiters == "none" else tuple(arbiters.split(",")))
    senders = [(publisher(*INPUTS[name][:2]), INPUTS[name].make, round(1 / PERIOD_S) // INPUTS[name].rate_hz)
               for name in names]
    threading.Thread(target=deadman.wait, daemon=True).start()
    ready()
    ticks = itertools.count()

    def publish():
        tick = next(ticks)
        for topic, make, every in senders:
            if tick % every == 0:
                topic.publish(make(deadman.is_held))
    at_50_hz(publish)


def board(*others):
    held = Int32MultiArray(DUTIES.layout, [DUTIES.data[0], NEUTRAL, *[-1] * 14])  # as turn_arb's state, see inputs
    outputs = publisher("/servo/output", Int32MultiArray)

    def on_command(message):
        duties = [old if new == -1 else new for old, new in zip(held.data, message.data)]
        if duties != held.data:
            held.data = duties
            outputs.publish(held)
    rospy.Subscriber("/servo/cmdVector", Int32MultiArray, on_command, queue_size=10, tcp_nodelay=True)
    for topic in others:
        ignore(topic, Int32MultiArray)
    ready()
    while not rospy.is_shutdown():
        outputs.publish(held)
        time.sleep(0.1)


class Measurements:
    """Publishes what a hub does besides the raw records, except what it does once a second."""

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


def line(link):
    terminal = Line(link)
    frames = list(captured(WHEELS, SONAR))
    going, order = threading.Event(), {}

    def read_commands():
        for text in sys.stdin:
            if text.strip() == "stop":
                going.clear()
                time.sleep(0.1)
                print("sent", order["frames"], flush=True)
            else:
                order.update(bytes_per_s=float(text.split()[1]) * 11_520, frames=0)
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
        ignore(topic)
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


def drive(speed_mps, *options):
    driver = Driver(float(speed_mps), "both" in options, "cmd_vel" in options)
    ready()
    at_50_hz(driver.publish)


ROLES = {role.__name__: role for role in (relay, sink, timer, inputs, board, pipe, line, count, drive)}


def main() -> None:
    arguments = rospy.myargv()[1:]
    # rospy's own handler swallows an interrupt while standard input is read.
    rospy.init_node(f"bench_{arguments[0]}", anonymous=True, disable_signals=True)
    sys.setswitchinterval(0.0005)  # as the package's nodes
    try:
        ROLES[arguments[0]](*arguments[1:])
    except (rospy.ROSException, KeyboardInterrupt):
        pass  # shutdown
    rospy.signal_shutdown("ended")
