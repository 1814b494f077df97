#!/usr/bin/env python3
"""Every node's parameters, message callbacks and services, fed with whatever a parameter server and topics can carry.

The nodes are built here, in this process, with a real inbox; what they subscribe to and serve is caught on the way, so
that thousands of messages a second can be put into them as rospy would, after a trip through the wire's format.
"""
from __future__ import annotations

import errno
import gc
import io
import math
import os
import random
import struct
import threading
import time
import tracemalloc
import tty
import unittest
from unittest import mock

import genpy
import rospy
import rostest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.interlock.motion_interlock import read_interlock
from car_interface.nodes import (
    car_display,
    car_sim,
    generic_value_converter,
    pca9685,
    teensy_sensor_hub,
    teleop_logi,
    throttle_arb,
    turn_arb,
)
from car_interface.ros import measurement_publisher, runtime
from car_interface.ros.inbox import Inbox

settings.register_profile("fuzz", database=None, deadline=None, derandomize=True,
                          suppress_health_check=list(HealthCheck))
settings.load_profile("fuzz")

WARM_UP = 1000  # messages to each topic
MESSAGES, READS = 3000, 1000
MAX_GROWTH = 100_000  # bytes over MESSAGES: a leak of 34 bytes a message shows
SETTLE_S = 1.0
CONFIG = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "config")
PORT = f"/tmp/car_interface_fuzz_{os.getpid()}"

SCALARS = st.one_of(
    st.none(), st.booleans(), st.integers(-2 ** 31, 2 ** 31 - 1), st.integers(-2, 20), st.floats(), st.text(max_size=8),
    st.sampled_from(["1e-3", "0x40", "nan", "1e999", "virtual", "/dev/null", "shipped", "auto", " "]))
LISTS = st.lists(st.one_of(st.integers(-1, 70000), st.floats(), SCALARS), max_size=18)
VALUES = st.one_of(SCALARS, LISTS, st.dictionaries(st.text(max_size=4), SCALARS, max_size=3))


def config(name):
    """A node's parameters as they are shipped."""
    with open(os.path.join(CONFIG, name), encoding="utf-8") as file:
        return yaml.safe_load(file)


def converter_config(**more):
    files = [name for name in os.listdir(CONFIG) if name.endswith(".csv")]
    return {**config("generic_value_converter.yaml"), "csv_path_value_map": os.path.join(CONFIG, files[0]), **more}


NODES = {
    "turn_arb": (turn_arb.TurnArb, lambda: config("turn_arb.yaml")),
    "generic_value_converter": (generic_value_converter.GenericValueConverter, converter_config),
    "throttle_arb": (throttle_arb.ThrottleArb, lambda: config("throttle.yaml")),
    "teleop_logi": (teleop_logi.TeleopLogi, lambda: config("teleop_logi.yaml")),
    "pca9685": (pca9685.Pca9685, lambda: {
        **config("pca9685.yaml"), "steering": config("turn_arb.yaml"), "esc": config("throttle.yaml"),
        "device": "virtual", "guard": False}),  # a guard outlives nodes that end as these do
    "teensy_sensor_hub": (teensy_sensor_hub.TeensySensorHub,
                          lambda: {**config("teensy_sensor_hub.yaml"), **config("sonars.yaml"), "port": PORT}),
    "car_display": (car_display.CarDisplay, dict),
    "car_sim": (car_sim.CarSim, lambda: {"port": f"{PORT}_sim"}),
}


def read_measurements(params):
    measurement_publisher.read_settings(params, 115200)


# What the hub reads by itself, beside the sensors' configuration.
MEASURED_ELSEWHERE = ("baud", "ping_period", "firmware_checksum", "use_steering", "publish_tf", "sonars",
                      "field_of_view")
READERS = {
    "turn_arb": (turn_arb.read_config, lambda: config("turn_arb.yaml")),
    "teleop_logi": (teleop_logi.read_config, lambda: config("teleop_logi.yaml")),
    "generic_value_converter": (generic_value_converter.read_config, converter_config),
    "throttle_arb": (throttle_arb.read_config, lambda: config("throttle.yaml")),
    "pca9685": (pca9685.read_config, lambda: {
        **config("pca9685.yaml"), "steering": config("turn_arb.yaml"), "esc": config("throttle.yaml"),
        "steering/servo_channel": 0, "steering/servo_center": 5100, "esc/servo/channel": 1,
        "esc/servo/neutral": 4915}),
    "teensy_sensor_hub": (teensy_sensor_hub.read_config,
                          lambda: {**config("teensy_sensor_hub.yaml"), **config("sonars.yaml"), "port": PORT}),
    "car_display": (car_display.read_config, lambda: {"wheelbase": 0.324, "frame_prefix": "car1/"}),
    "measurements": (read_measurements, lambda: {
        name: value for name, value in {**config("teensy_sensor_hub.yaml"), **config("sonars.yaml")}.items()
        if name not in MEASURED_ELSEWHERE}),
    "permission": (read_interlock,
                   lambda: {"human_timeout": 0.5, "e_stop_timeout": 1.0, "e_stop_required": False,
                            "grant_at_start": False}),
    "car_sim": (car_sim.read_config, lambda: {
        "steering_duties": [3800, 5100, 6700], "steering_curvatures": [1.0, 0.0, -1.0], "start": [0, 0, 0],
        "wheelbase": 0.324, "track": 0.296, "wheel_diameter": 0.095, "pulses_per_revolution": 20,
        "forward_acceleration": 3, "reverse_acceleration": 3, "brake_deceleration": 5,
        "wheel_pulses": [0.3, 1.7], "clock_start_ms": 300, "clock_drift_ppm": 0, "corrected_checksum": False, "seed": 1,
        "sonar_pulse_end": 38_000}),
}


class Built:
    """A node in this process, and the doors into it."""

    def __init__(self, name, values=None):
        make, shipped = NODES[name]
        self.topics = {}
        self.services = {}
        self.inbox = Inbox()
        with mock.patch.object(rospy, "Subscriber", self._subscribe), mock.patch.object(rospy, "Service", self._serve):
            self.node = make(Params(shipped() if values is None else values), self.inbox)

    def _subscribe(self, topic, message_type, callback, **_):
        self.topics[topic] = (message_type, callback)
        return mock.Mock()

    def _serve(self, name, service_type, handler, **_):
        self.services[name] = (service_type, handler)
        return mock.Mock()

    def step(self):
        """Let it live a moment."""
        due_ns = self.node.step(time.monotonic_ns())
        if not math.isfinite(due_ns):
            raise AssertionError(f"its next step is due at {due_ns}")

    def ask(self, handler, request):
        """What a service answers: its handler waits in a thread of its own, as rospy's does."""
        answers = []
        thread = threading.Thread(target=lambda: answers.append(handler(request)), daemon=True)
        thread.start()
        deadline_s = time.monotonic() + 10
        while thread.is_alive() and time.monotonic() < deadline_s:
            self.step()
            thread.join(0.001)
        return answers[0]

    def end(self):
        """Shut it down; a port that was never there is no fault of its."""
        try:
            self.node.shut_down()
        except CarInterfaceError:
            pass


INTEGERS = {"int8": "b", "uint8": "B", "byte": "b", "char": "B", "int16": "h", "uint16": "H", "int32": "i",
            "uint32": "I", "int64": "q", "uint64": "Q"}
FLOATS = (0.0, -0.0, 1.0, -1.0, 0.3, 1e-40, 3.4e38, -3.4e38, math.nan, math.inf, -math.inf)
DOUBLES = (*FLOATS, 5e-324, 1.7e308, -1.7e308, 1e18)
LENGTHS = (0, 1, 2, 6, 11, 15, 16, 16, 16, 17, 40, 300)
TEXTS = ("", "a", "nack", "hold", "power", "\0", "ä" * 50, "../../etc/passwd", "$(reboot)", "%s%n", "\x1b[2J")


def anything(type_name, choose):
    """A value of a ROS type."""
    base, is_array, length = split(type_name)
    if is_array:
        count = length if length is not None else choose.choice(LENGTHS)
        values = [anything(base, choose) for _ in range(count)]
        return bytes(values) if base in ("uint8", "char") else values
    if base in INTEGERS:
        bits = 8 * struct.calcsize(INTEGERS[base])
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if INTEGERS[base].islower() else (0, (1 << bits) - 1)
        return choose.choice((low, high, max(low, -1), 0, 1, min(high, 5100), choose.randint(low, high)))
    if base == "bool":
        return choose.random() < 0.5
    if base == "float32":
        return choose.choice((*FLOATS, choose.uniform(-2, 2)))
    if base == "float64":
        return choose.choice((*DOUBLES, choose.uniform(-2, 2)))
    if base == "string":
        return choose.choice(TEXTS)
    if base in ("time", "duration"):
        stamps = ((0, 0), (0, 1), (2 ** 31 - 1, 999_999_999), (int(time.time()), 5))
        make = genpy.Time if base == "time" else genpy.Duration
        return make(*choose.choice((*stamps, (2 ** 32 - 1, 0)) if base == "time" else (*stamps, (-2 ** 31, 0))))
    return filled(genpy.message.get_message_class("std_msgs/Header" if base == "Header" else base), choose)


def split(type_name):
    """A type's base, whether it's an array, and how long one of fixed length is."""
    if not type_name.endswith("]"):
        return type_name, False, None
    base, _, length = type_name[:-1].partition("[")
    return base, True, int(length) if length else None


def filled(message_type, choose):
    """A message of any content, as it comes off the wire."""
    message = message_type()
    for name, type_name in zip(message.__slots__, message._slot_types):
        setattr(message, name, anything(type_name, choose))
    wire = io.BytesIO()
    message.serialize(wire)
    return message_type().deserialize(wire.getvalue())


class FuzzTest(unittest.TestCase):
    def check_readers(self, name):
        """Only ConfigError may come out."""
        read, shipped = READERS[name]
        good = shipped()
        read(Params(good))

        @settings(max_examples=400)
        @given(st.dictionaries(st.sampled_from(sorted(good)), VALUES, min_size=1, max_size=3))
        def check(changes):
            try:
                read(Params({**good, **changes}))
            except ConfigError as error:
                self.assertTrue(str(error))
        check()

    def check_start(self, name):
        """It starts and lives a moment, or says why not."""
        good = NODES[name][1]()
        known = sorted({*good, "required", "nonsense", "input_timeout", "e_stop_timeout", "prescale", "address"})

        @settings(max_examples=40)
        @given(st.dictionaries(st.sampled_from(known), VALUES, min_size=1, max_size=2))
        def check(changes):
            try:
                Built(name, {**good, **changes}).step()
            except CarInterfaceError as error:
                self.assertTrue(str(error))
        with mock.patch.object(rospy, "Publisher", mock.Mock()):
            check()

    def feed(self, built, choose, count):
        for _ in range(count):
            for message_type, callback in built.topics.values():
                callback(filled(message_type, choose))
            if choose.random() < 0.2:
                built.step()
        built.step()

    def check_messages(self, name):
        """It lives on, and its memory doesn't grow."""
        choose = random.Random(3)
        built = Built(name)
        try:
            self.assertTrue(built.topics)
            self.feed(built, choose, WARM_UP)
            self.check_growth(f"{name}, {MESSAGES} messages to each of {len(built.topics)} topics",
                              lambda: self.feed(built, choose, MESSAGES))
        finally:
            built.end()

    def check_growth(self, title, feed):
        """The memory that Python holds grows by little, once other threads hold nothing more, as lines for the log."""
        tracemalloc.start()
        try:
            before = self.held_bytes()
            feed()
            growth = self.held_bytes() - before
            print(f"{title}: memory grew by {growth} bytes")
            self.assertLess(growth, MAX_GROWTH, title)
        finally:
            tracemalloc.stop()

    @staticmethod
    def held_bytes():
        """The least that Python holds within a second."""
        least, until_s = math.inf, time.monotonic() + SETTLE_S
        while time.monotonic() < until_s:
            gc.collect()
            least = min(least, tracemalloc.get_traced_memory()[0])
            time.sleep(0.02)
        return least

    def check_services(self, name):
        """Each answers, in words."""
        choose = random.Random(4)
        built = Built(name)
        try:
            self.assertTrue(built.services)
            for service_type, handler in built.services.values():
                for _ in range(40):
                    response = built.ask(handler, filled(service_type._request_class, choose))
                    # What is tuned live is answered with what is in force, not in words.
                    self.assertTrue(getattr(response, "message", None) or response.ints, service_type)
        finally:
            built.end()

    def test_serial_port_that_sends_anything_leaves_the_hub_alive_and_no_larger(self):
        near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(near, False)
        os.symlink(os.ttyname(far), PORT)
        built = Built("teensy_sensor_hub")
        try:
            built.step()
            self.flood(built, near, 300)
            self.check_growth(f"teensy_sensor_hub, {READS} reads of noise", lambda: self.flood(built, near, READS))
        finally:
            built.end()
            os.unlink(PORT)
            os.close(near)
            os.close(far)

    def flood(self, built, near, count):
        choose = random.Random(5)
        sonar = bytes.fromhex("7e01020600006b11057b0000f97e")
        for index in range(count):
            noise = bytes(choose.choices((0x7E, 0x7D, 0x00, 0xFF, choose.randrange(256)), k=choose.randrange(200)))
            self.write(near, noise + sonar if index % 3 else sonar)
            built.step()
            try:
                os.read(near, 4096)
            except OSError as error:
                if error.errno != errno.EAGAIN:
                    raise

    @staticmethod
    def write(near, data):
        try:
            os.write(near, data)
        except BlockingIOError:
            pass


def add_tests(outcome, check, names):
    """A test of its own for each name: a subtest that fails is counted by rostest, and not told."""
    for name in names:
        setattr(FuzzTest, f"test_{name}_{outcome}".replace(" ", "_").replace("'", ""),
                lambda self, name=name: check(self, name))


add_tests("with_parameters_of_any_value_reads_them_or_refuses_with_a_config_error", FuzzTest.check_readers, READERS)
add_tests("with_any_parameters_starts_or_refuses_with_an_error_of_ours", FuzzTest.check_start,
          [name for name in NODES if name != "car_sim"])  # which puts a link wherever it is told
add_tests("fed_messages_of_any_content_lives_on_and_is_no_larger", FuzzTest.check_messages,
          NODES)
add_tests("with_services_asked_anything_answers_in_words", FuzzTest.check_services,
          ["turn_arb", "throttle_arb", "teensy_sensor_hub", "pca9685", "car_sim"])

if __name__ == "__main__":
    runtime.logging.raiseExceptions = False
    rospy.init_node("fuzz_test", log_level=rospy.FATAL)
    rostest.rosrun("car_interface", "fuzz_test", FuzzTest)
