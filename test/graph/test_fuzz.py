"""Every node's parameters, messages and services, fed with whatever a parameter server and topics can carry.

The cases are always the same, and with ``./dev test --all`` others, and more of them, each time: then a failure prints
the seed that makes them again.
"""
from __future__ import annotations

import functools
import gc
import math
import os
import random
import struct
import tracemalloc
from typing import NamedTuple

import genpy
import pytest
import rospy

from car import Car
from car_interface.common.declared import read_all
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.params import Params
from car_interface.nodes.car_display import CarDisplay
from car_interface.ros.start import config_class

ALL = bool(os.environ.get("CAR_INTERFACE_ALL"))
SEED = int(os.environ.get("CAR_INTERFACE_SEED", random.SystemRandom().randrange(10 ** 6) if ALL else 3))
READS, STARTS, REQUESTS = (20_000, 1000, 400) if ALL else (300, 25, 20)
WARM_UP, MESSAGES = (1000, 1000) if ALL else (50, 60)  # to each topic, and as many again in each round
MAX_GROWTH = 30 * MESSAGES  # bytes: less than any object that is kept for each message
ROUNDS = 6  # what is kept for each message grows in every one; Python's own caches grow in the first ones

SCALARS = (None, True, False, "", " ", "a", "nan", "1e-3", "0x40", "1e999", "virtual", "/dev/null", "shipped", "auto",
           "ä\0", "9" * 400, math.nan, math.inf, -math.inf, 5e-324, -1e308, 1e-310, -0.0, 0.5, -1, 0, 1, 2, 15, 16, 300,
           65535, 65536, 2 ** 31 - 1, -2 ** 31)


class Fuzzed(NamedTuple):
    """How a node is started, and which parameters it knows beside those that are shipped."""

    start: object
    more: dict


def car_display(car, **parameters):
    return car.graph.add(CarDisplay, "car_display", parameters)


NODES = {
    "turn_arb": Fuzzed(Car.turn_arb, {"input_timeout": 0.5, "e_stop_timeout": 1.0}),
    "throttle_arb": Fuzzed(Car.throttle_arb, {}), "generic_value_converter": Fuzzed(Car.converter, {}),
    "teleop_logi": Fuzzed(Car.teleop, {}), "planner_interface": Fuzzed(Car.planner_interface, {}),
    "pca9685": Fuzzed(Car.pca9685, {"required": False, "prescale": 121, "address": 64}),
    "teensy_sensor_hub": Fuzzed(Car.hub, {"required": False, "port": "/dev/x"}),
    "car_display": Fuzzed(car_display, {"wheelbase": 0.324, "frame_prefix": "car1/", "track": 0.3}),
    "car_sim": Fuzzed(Car.sim, {
        "steering_duties": [3800, 5100, 6700], "steering_curvatures": [1.0, 0.0, -1.0], "start": [0, 0, 0],
        "track": 0.296, "wheel_diameter": 0.095, "pulses_per_revolution": 20,
        "forward_acceleration": 3, "reverse_acceleration": 3, "brake_deceleration": 5, "wheel_pulses": [0.3, 1.7],
        "clock_start_ms": 300, "clock_drift_ppm": 0, "corrected_checksum": False, "sonar_pulse_end": 38_000})}
SERVING = ("turn_arb", "throttle_arb", "teensy_sensor_hub", "car_sim")


def any_value(choose, may_nest=True):
    """A value that a parameter server can hold."""
    kind = choose.random()
    if kind < 0.2 and may_nest:
        return [any_value(choose, False) for _ in range(choose.choice((0, 1, 2, 3, 3, 6, 16, 18)))]
    if kind < 0.25 and may_nest:
        return {name: any_value(choose, False) for name in choose.sample(("x", "a/b", "ä", "servo"), 2)}
    if kind < 0.4:
        return choose.choice((choose.uniform(-3, 3), choose.randrange(-2, 70_000)))
    return choose.choice(SCALARS)


def changed(good, choose):
    """Some parameters with any value, or one that is near the good one."""
    changes = {name: any_value(choose) for name in choose.sample(sorted(good), choose.randrange(1, 4))}
    for name in changes:
        if type(good[name]) in (int, float) and choose.random() < 0.5:
            changes[name] = type(good[name])(good[name] * choose.uniform(0.5, 1.5))
    if choose.random() < 0.05:
        changes["nonsense"] = 1
    return changes


def flat(values, prefix=""):
    found = {}
    for name, value in values.items():
        found.update(flat(value, f"{prefix}{name}/") if isinstance(value, dict) else {f"{prefix}{name}": value})
    return found


def good_parameters(name):
    """A node's parameters as it is started, but for those that leave the process."""
    car, fuzzed = Car(), NODES[name]
    fuzzed.start(car)
    values = {**flat(car.graph.parameter(f"/{name}", {})), **fuzzed.more}
    return {name: value for name, value in values.items() if name != "guard"}


def fails(what, error):
    raise AssertionError(f"CAR_INTERFACE_SEED={SEED}: {what}") from error


@pytest.mark.parametrize("name", NODES)
def test_node_reads_parameters_of_any_value_or_refuses_them_with_a_config_error(name):
    read = functools.partial(read_all, config_class=config_class(name))
    good, choose, refused = good_parameters(name), random.Random(SEED), 0
    read(Params(good))
    for _ in range(READS):
        changes = changed(good, choose)
        try:
            read(Params({**good, **changes}))
        except ConfigError as error:
            assert str(error)
            refused += 1
        except Exception as error:
            fails(changes, error)
    assert READS / 5 < refused < READS


@pytest.mark.parametrize("name", NODES)
def test_node_started_with_any_parameters_lives_or_says_why_not(name):
    good, choose = good_parameters(name), random.Random(SEED)
    lived = 0
    for _ in range(STARTS):
        changes, car = changed(good, choose), Car()
        try:
            node = NODES[name].start(car, **changes)
            car.graph.run(0.03)
            lived += node.is_alive
            assert node.is_alive or node.fault
        except CarInterfaceError as error:
            assert str(error)
        except Exception as error:
            fails(changes, error)
    assert 0 < lived < STARTS


# --- messages and services ---

INTEGERS = {"int8": "b", "uint8": "B", "byte": "b", "char": "B", "int16": "h", "uint16": "H", "int32": "i",
            "uint32": "I", "int64": "q", "uint64": "Q"}
FLOATS = (0.0, -0.0, 1.0, -1.0, 0.3, 1e-40, 3.4e38, -3.4e38, math.nan, math.inf, -math.inf)
DOUBLES = (*FLOATS, 5e-324, 1.7e308, -1.7e308, 1e18)
LENGTHS = (0, 1, 2, 6, 11, 15, 16, 16, 16, 17, 40)
TEXTS = ("", "a", "nack", "hold", "power", "\0", "ä" * 50, "../../etc/passwd", "$(reboot)", "%s%n", "\x1b[2J")
OTHER_TYPES = ("std_msgs/Float32", "std_msgs/String", "geometry_msgs/Twist", "geometry_msgs/TwistStamped")


def anything(type_name, choose):
    if type_name.endswith("]"):
        base, _, length = type_name[:-1].partition("[")
        values = [anything(base, choose) for _ in range(int(length) if length else choose.choice(LENGTHS))]
        return bytes(values) if base in ("uint8", "char") else values
    if type_name in INTEGERS:
        bits = 8 * struct.calcsize(INTEGERS[type_name])
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if INTEGERS[type_name].islower() else (0, (1 << bits) - 1)
        return choose.choice((low, high, max(low, -1), 0, 1, min(high, 5100), choose.randint(low, high)))
    if type_name == "bool":
        return choose.random() < 0.5
    if type_name in ("float32", "float64"):
        return choose.choice((*(FLOATS if type_name == "float32" else DOUBLES), choose.uniform(-2, 2)))
    if type_name == "string":
        return choose.choice(TEXTS)
    if type_name in ("time", "duration"):
        stamps = ((0, 0), (0, 1), (2 ** 31 - 1, 999_999_999), (1_700_001_000, 5))
        make = genpy.Time if type_name == "time" else genpy.Duration
        return make(*choose.choice((*stamps, (2 ** 32 - 1, 0)) if type_name == "time" else (*stamps, (-2 ** 31, 0))))
    return filled(genpy.message.get_message_class("std_msgs/Header" if type_name == "Header" else type_name), choose)


def filled(message_type, choose):
    message = message_type()
    for name, type_name in zip(message.__slots__, message._slot_types):
        setattr(message, name, anything(type_name, choose))
    return message


def forget(car):
    """Drop what the test keeps, so that what grows is the node."""
    car.graph.log.clear()
    del car.board.changes[:-1]
    for records in car.graph.recorded.values():
        records.clear()


def feed(car, node, choose, count):
    """Messages to each topic of a node, and now and then a moment to handle them."""
    graph = car.graph
    for _ in range(count):
        for subscriptions in list(graph.subscriptions.values()):
            for subscription in subscriptions:
                message_type = subscription.type_class
                if message_type is rospy.AnyMsg:
                    message_type = genpy.message.get_message_class(choose.choice(OTHER_TYPES))
                graph.publish(subscription.resolved_name, filled(message_type, choose), f"/{message_type.__name__}")
        if choose.random() < 0.2:
            graph.run(choose.choice((0, 0.002, 0.03)))
            assert node.is_alive, f"CAR_INTERFACE_SEED={SEED}: {node.fault}"
        forget(car)
    graph.run(1.0)
    forget(car)


def check_growth(act):
    """In one of some equal rounds the memory that Python holds grows by little."""
    tracemalloc.start()
    try:
        assert any(growth_of(act) < MAX_GROWTH for _ in range(ROUNDS)), f"CAR_INTERFACE_SEED={SEED}"
    finally:
        tracemalloc.stop()


def growth_of(act):
    """How many more bytes Python holds after an act."""
    gc.collect()
    before, _ = tracemalloc.get_traced_memory()
    act()
    gc.collect()
    return tracemalloc.get_traced_memory()[0] - before


@pytest.mark.once
@pytest.mark.parametrize("name", NODES)
def test_node_fed_messages_of_any_content_lives_on_and_is_no_larger(car, name):
    choose, node = random.Random(SEED), NODES[name].start(car)
    car.graph.record(*car.graph.publishers)  # so that all that it publishes is serialised
    feed(car, node, choose, WARM_UP)
    check_growth(lambda: feed(car, node, choose, MESSAGES))


@pytest.mark.parametrize("name", SERVING)
def test_node_asked_anything_by_its_services_answers_in_words(car, name):
    choose, node = random.Random(SEED), NODES[name].start(car)
    car.graph.run(0.1)
    services = [service for service in car.graph.services if service in car.graph.service_types]
    assert services
    for service in services:
        for _ in range(REQUESTS):
            request = filled(car.graph.service_types[service]._request_class, choose)
            try:
                answer = car.graph.call(service, request)
                assert answer.config.ints if service.endswith("/set_parameters") else answer.message
            except Exception as error:
                fails((service, request), error)
    assert node.is_alive
