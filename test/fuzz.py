#!/usr/bin/env python3
"""Random things at everything that comes from outside, for as many minutes as asked for: ``./dev fuzz``.

Hostile peers are at the nodes of ``demo.launch drive:=false``; the other kinds have nodes of their own, on the clock of
test/graph. Nobody holds a deadman: what moves is a finding, and so is an exception that isn't this package's, a
traceback in a node's log, a node that ends, and memory that grows. Exit code 1: something was found. Each finding has
kind, seed and input: ``--only KIND --seed SEED --minutes 0`` repeats it, and what it was becomes a test.
"""
from __future__ import annotations

import argparse
import asyncio
import logging
import os
import random
import socket
import struct
import sys
import tempfile
import threading
import time
import traceback
import xmlrpc.client
from collections import Counter
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import genpy
import rosbag
import rosgraph
import rospy
from std_msgs.msg import Int32MultiArray

sys.path.append(str(Path(__file__).resolve().parent / "process"))
sys.path.append(str(Path(__file__).resolve().parent / "graph"))
sys.path.append(str(Path(__file__).resolve().parent / "unit/nodes/phone_drive"))
import test_attacks as attacks
from damage import damaged
from soak import NEUTRALS, NODES, footprint

import test_fuzz as graph
from car import CENTER, ESC, ESC_NEUTRAL, STEERING, Car
from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.steering.config import load_steering
from car_interface.teleop.mappings import load_entries
from car_interface.throttle.config import load_throttle
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.recordings import calibration_result, recording
from closing import ask

TEST = Path(__file__).resolve().parent
# Who sends these may drive.
PERMITS = {"/joy", "/phone/joy", "/teleop_logi/human_in_loop", "/command", "/servo/cmdVector"}
MAX_SHOWN = 300  # characters of an input
TURN_S = 3.0  # of one kind, before the next one's; one case of memory alone takes some 10 s
SETTLE_S = 5.0  # until the peers' last handshakes have ended
MAX_OPEN = 50  # peers that stay and say no more


def check(fine: object, what: object) -> None:
    if not fine:
        raise AssertionError(what)


def check_line(error: Exception, names=()) -> None:
    """An error of this package is one line, which names one of these."""
    is_named = not names or any(name.split("/")[-1] in str(error) for name in names)
    check(str(error) and "\n" not in str(error) and is_named, f"not one line that names it: {str(error)!r}")


# --- the kinds: each does one case, and notes what it is about to feed ---

def parameters(choose, note):
    name = choose.choice(sorted(graph.NODES))
    changes, car = graph.changed(graph.good_parameters(name), choose), Car()
    note((name, changes))
    try:
        node = graph.NODES[name].start(car, **changes)
        car.graph.run(0.1)
        check(node.is_alive or node.fault and "Traceback" not in node.fault, node.fault)
    except CarInterfaceError as error:
        check_line(error, changes if isinstance(error, ConfigError) else ())


def messages(choose, note):
    """On all topics of a whole car but those that permit motion."""
    car = Car().whole(planner="speed")
    car.graph.run(1.5)
    begun_ns = car.graph.now_ns
    for _ in range(20):
        for topic, subscriptions in list(car.graph.subscriptions.items()):
            for subscription in subscriptions if topic not in PERMITS else ():
                kind = subscription.type_class
                if kind is rospy.AnyMsg:
                    kind = genpy.message.get_message_class(choose.choice(graph.OTHER_TYPES))
                message = graph.filled(kind, choose)
                note((topic, message))
                car.graph.publish(topic, message, f"/{kind.__name__}")
        car.graph.run(choose.choice((0.002, 0.03, 0.2)))
        check(all(node.is_alive for node in car.graph.nodes.values()), [n.fault for n in car.graph.nodes.values()])
    for channel, neutral in ((STEERING, CENTER), (ESC, ESC_NEUTRAL)):
        moved = [change for change in car.board.since(begun_ns, channel) if change[1] not in (0, neutral)]
        check(not moved, f"motion without permission: channel {channel}, {moved[:3]}")


def memory(choose, note):
    """One node's, while it is fed."""
    name, graph.SEED = choose.choice(sorted(graph.NODES)), choose.randrange(10 ** 6)
    note((name, graph.SEED))
    graph.test_node_fed_messages_of_any_content_lives_on_and_is_no_larger(Car(), name)
    if name in graph.SERVING:
        graph.test_node_asked_anything_by_its_services_answers_in_words(Car(), name)


CAPTURE = (TEST / "data/capture_mixed.bin").read_bytes()


def serial(choose, note):
    """Bytes in both directions, between those of the virtual Teensy."""
    car = Car()
    nodes = car.sim(), car.hub()
    car.graph.run(0.5)
    for _ in range(50):
        start = choose.randrange(len(CAPTURE))
        data = damaged(CAPTURE[start:start + choose.choice((5, 20, 40, 200))], choose)
        note(data)
        car.cable.to_computer(data)
        if choose.random() < 0.3 and car.cable.terminal is not None:
            car.cable.terminal.take(data)
        car.graph.run(choose.choice((0.0, 0.003, 0.05)))
        check(all(node.is_alive for node in nodes), [node.fault for node in nodes])


def read_result(path):
    with suppress(ValueError):
        calibration_result.parsed(Path(path).read_text(encoding="utf-8", errors="replace"))


def read(path):
    return list(recording.read(path, recording.contents(path).topics))


READERS = {"turn_arb.yaml": load_steering, "throttle.yaml": load_throttle, "value_map.csv": load_value_map,
           "gamepads.yaml": lambda path: load_entries(os.path.dirname(path)), "result.json": read_result,
           "drive.bag": read, "drive.mcap": read}
SIDE = '[[0.5, 3800, 3800.0, 1.0, 2.0, 3, 0.1, "driven"]]'
RESULT = f'["", ["a"], ["b"], [0.5], {SIDE}, {SIDE}, [5100, 5090], [[5000, 0.1]], [[5000, 0.1, 0.01]], [[5000, 0.1]]]'
GOOD = {"result.json": RESULT.encode(), "drive.mcap": (TEST / "data/autoware_mcap/autoware_mcap.mcap").read_bytes()}


def files(choose, note):
    name = choose.choice(sorted(READERS))
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, name)
        if name == "drive.bag" and name not in GOOD:
            with rosbag.Bag(path, "w") as writer:
                for number in range(20):
                    writer.write("/servo/output", Int32MultiArray(data=[number] * 16), rospy.Time(1000 + number))
            GOOD[name] = Path(path).read_bytes()
        if name not in GOOD:
            GOOD[name] = (TEST.parent / "config" / name).read_bytes()
        data = damaged(GOOD[name], choose)
        note((name, data))
        Path(path).write_bytes(data)
        try:
            READERS[name](path)
        except CarInterfaceError as error:
            check_line(error)


def phone(choose, note):
    """Pages that send nonsense, and what isn't even a page's."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    core = attacks.Core(port)
    core.port = port
    frames = [attacks.malformed(choose) for _ in range(40)]
    note(frames)

    async def attack():
        await attacks.flood(core, frames)
        await attacks.flood(core, [damaged(frames[0].encode("utf-8", "surrogatepass"), choose)] * 3, binary=True)
        with socket.create_connection(("127.0.0.1", port)) as raw, suppress(OSError):
            raw.sendall(damaged(attacks.upgrade(core) + b"\x81\x85" + bytes(9), choose))
    try:
        asyncio.run(attack())
        check(core.thread.is_alive() and not core.phones.controls(time.monotonic_ns()).manual, core.thread)
    finally:
        core.stop()


CALLS = ("getPid", "getBusInfo", "getSubscriptions", "requestTopic", "paramUpdate", "nonsense")
OPEN: list[socket.socket] = []


def peers(choose, note):
    """At a node's two ports, slow or at once: a header or a call, damaged; some say no more, and stay."""
    node = choose.choice(NODES)
    topic = choose.choice(ask(node, "getPublications"))[0]
    if choose.random() < 0.6:
        port = ask(node, "requestTopic", topic, [["TCPROS"]])[2]
        fields = {"callerid": "/peer", "topic": topic, "type": "*", "md5sum": "*"}
        fields[choose.choice(sorted(fields))] = choose.choice(graph.TEXTS)
        pairs = [f"{name}={value}".encode() for name, value in fields.items()]
        body = b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)
        data = struct.pack("<I", choose.choice((len(body),) * 4 + (0, 2 ** 32 - 1))) + body
    else:
        port = int(rosgraph.Master("/fuzz").lookupNode(node).rstrip("/").rpartition(":")[2])
        arguments = "/peer", *(graph.any_value(choose, False) for _ in range(choose.randrange(4)))
        body = xmlrpc.client.dumps(arguments, choose.choice(CALLS), allow_none=True).encode()
        data = b"POST / HTTP/1.1\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    data = damaged(data, choose)
    note((node, data))
    peer, size = socket.create_connection(("127.0.0.1", port), 5), max(1, len(data) // choose.choice((1, 1, 5)))
    with suppress(OSError):
        for start in range(0, len(data), size):
            peer.sendall(data[start:start + size])
            time.sleep(0.02 if size < len(data) else 0.0)
        peer.settimeout(0.02)
        peer.recv(4096)
    OPEN.append(peer)
    for each in (OPEN.pop(choose.randrange(len(OPEN))) for _ in range(len(OPEN) > choose.choice((0, 0, MAX_OPEN)))):
        each.close()
    check(ask(node, "getPid") is not None, f"{node} answers no more")


KINDS = {kind.__name__: kind for kind in (peers, messages, parameters, files, serial, phone, memory)}


class Fuzz:
    """The cases of a run, and how many of them found something."""

    def __init__(self, seed: int):
        self._seed, self._counts, self._input, self._errors, self.found = seed, Counter(), None, [], 0
        threading.excepthook = lambda args: self._errors.append(repr(args.exc_value))
        handler = logging.Handler(logging.WARNING)
        handler.emit = lambda record: self._errors.append(record.getMessage()) if record.exc_info else None
        logging.getLogger().addHandler(handler)

    def report(self, kind: str, seed: int, what: object) -> None:
        self.found += 1
        print(f"FOUND {kind}, seed {seed}: {what}\n  input {repr(self._input)[:MAX_SHOWN]}", flush=True)

    def one(self, kind: str) -> None:
        seed = self._seed + self._counts[kind]
        self._counts[kind] += 1
        self._errors.clear()
        try:
            KINDS[kind](random.Random(seed), lambda value: setattr(self, "_input", value))
            check(not self._errors, self._errors[:2])
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            self.report(kind, seed, f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})")

    def run(self, kinds: list[str], minutes: float) -> None:
        end_s, before = time.monotonic() + 60 * minutes, {}
        for kind in cycle(kinds):
            until_s = min(time.monotonic() + TURN_S, end_s)
            self.one(kind)
            while time.monotonic() < until_s:
                self.one(kind)
            if time.monotonic() >= end_s and set(self._counts) == set(kinds):
                break
            if not before and time.monotonic() > end_s - 30 * minutes:
                before = footprints()
        self._input = None
        for node, after in footprints().items():
            if before and before[node].has_grown_until(after):
                self.report("peers", self._seed, f"{node} has grown: {before[node]}, then {after}")
        print(", ".join(f"{kind} {count}" for kind, count in self._counts.items()))


def footprints():
    while OPEN:
        OPEN.pop().close()
    time.sleep(SETTLE_S)
    return {node: footprint(node) for node in NODES}


def main() -> int:
    parser = argparse.ArgumentParser(prog="./dev fuzz", description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10 ** 6))
    parser.add_argument("--only", choices=KINDS, help="this kind alone")
    arguments = parser.parse_args(rospy.myargv()[1:])
    print(f"seed {arguments.seed}", flush=True)
    rospy.init_node("fuzz", disable_rosout=True)
    fuzz, moved = Fuzz(arguments.seed), []
    rospy.Subscriber("/servo/output", Int32MultiArray, lambda message: moved.extend(
        (channel, message.data[channel]) for channel, neutral in NEUTRALS.items()
        if message.data[channel] not in (neutral, 0, -1)))
    fuzz.run([arguments.only] if arguments.only else list(KINDS), arguments.minutes)
    if moved:
        fuzz.report("peers", arguments.seed, f"motion without permission: {moved[:3]}")
    log = (Path(os.environ["ROS_LOG_DIR"]) / "roslaunch.log").read_text(encoding="utf-8", errors="replace").splitlines()
    for number in [number for number, text in enumerate(log) if "Traceback" in text][:5]:
        fuzz.report("peers", arguments.seed, "traceback in a node's log: " + " | ".join(log[number:number + 20]))
    print(f"found {fuzz.found}")
    return 1 if fuzz.found else 0


if __name__ == "__main__":
    sys.exit(main())
