#!/usr/bin/env python3
"""Random things at everything that comes from outside, for as many minutes as asked for: ``./dev fuzz``.

It runs beside ``demo.launch drive:=false``, whose nodes get the hostile peers; the rest has nodes of its own, on the
clock of test/graph. Nobody holds a deadman: what moves is a finding, and so is an exception that isn't this package's, a
traceback in a node's log, a node that ends, and memory that grows. Exit code 1: something was found. Each finding has
its kind, seed and input: ``--only KIND --seed SEED --minutes 0`` does it again, and what it was becomes a test.
"""
from __future__ import annotations

import argparse
import asyncio
import importlib.util
import json
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
import rosgraph
import rospy
from std_msgs.msg import Int32MultiArray

TEST = Path(__file__).resolve().parent
sys.path += [str(TEST / "process"), str(TEST / "graph")]
from car import CENTER, ESC, ESC_NEUTRAL, STEERING, Car
from closing import ask
from soak import NEUTRALS, NODES, footprint

from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.common.yaml_file import load_yaml
from car_interface.steering.config import load_steering
from car_interface.teleop.mappings import load_entries
from car_interface.throttle.config import load_throttle
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.recordings import calibration_result, recording

CONFIG = TEST.parent / "config"
PERMITS = {"/joy", "/human_in_loop", "/servo/cmdVector"}  # who sends these may drive: docs/security.md
MAX_SHOWN = 300
PIECES = (b"", b"\0", b"nan", b"1e999", b"-", b": ", b"[" * 40, b"{", b"&a *a", b"!!python/object:os.system ", b"\n",
          b'"', b",", b"\xff\xfe", b"9" * 400, b"\t", b"#", b"<<: ")
CASES_S = 1.0  # of one kind, before it is the next one's turn
SETTLE_S = 5.0  # until the peers' last handshakes have ended


def module_of(path: str):
    """Import a module of tests, of which several have the same name."""
    spec = importlib.util.spec_from_file_location(path.replace("/", "_"), str(TEST / f"{path}.py"))
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


line_fuzz, graph_fuzz = module_of("unit/test_fuzz"), module_of("graph/test_fuzz")
attacks = module_of("unit/nodes/phone_drive/test_attacks")


class Found(Exception):
    """Something that must not be."""


def check(fine: bool, what: str) -> None:
    if not fine:
        raise Found(what)


def check_line(error: Exception, names=()) -> None:
    """An error of this package is one line, which names one of these."""
    text = str(error)
    check(text != "" and "\n" not in text, f"not one line: {text!r}")
    check(not names or any(name.split("/")[-1] in text for name in names), f"it names none of {names}: {text}")


def damaged(data: bytes, choose: random.Random) -> bytes:
    """Some places of it lost, doubled, inserted, flipped, or all from one on."""
    found = bytearray(data)
    for _ in range(choose.choice((0, 1, 1, 2, 4, 16))):
        start = choose.randrange(len(found) + 1)
        end = start + choose.choice((0, 1, 3, 30))
        change = choose.randrange(6)
        if change == 0:
            del found[start:end]
        elif change == 1:
            found[start:start] = found[start:end]
        elif change == 2:
            found[start:end] = choose.choice(PIECES)
        elif change == 3 and start < len(found):
            found[start] ^= 1 << choose.randrange(8)
        elif change == 4:
            found[start:end] = choose.getrandbits(64).to_bytes(8, "little")
        elif choose.random() < 0.2:
            del found[start:]
    return bytes(found)


# --- the kinds: each does one case, and notes what it is about to feed ---

def parameters(choose, note):
    name = choose.choice(sorted(graph_fuzz.NODES))
    changes, car = graph_fuzz.changed(graph_fuzz.good_parameters(name), choose), Car()
    note((name, changes))
    try:
        node = graph_fuzz.NODES[name].start(car, **changes)
        car.graph.run(0.1)
        check(node.is_alive or "Traceback" not in node.fault and node.fault != "", node.fault)
    except ConfigError as error:
        check_line(error, changes)
    except CarInterfaceError as error:
        check_line(error)


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
                    kind = genpy.message.get_message_class(choose.choice(graph_fuzz.OTHER_TYPES))
                message = graph_fuzz.filled(kind, choose)
                note((topic, message))
                car.graph.publish(topic, message, f"/{kind.__name__}")
        car.graph.run(choose.choice((0.002, 0.03, 0.2)))
        check(all(node.is_alive for node in car.graph.nodes.values()), [n.fault for n in car.graph.nodes.values()])
    for channel, neutral in ((STEERING, CENTER), (ESC, ESC_NEUTRAL)):
        moved = [change for change in car.board.since(begun_ns, channel) if change[1] not in (0, neutral)]
        check(not moved, f"motion without permission: channel {channel}, {moved[:3]}")


def memory(choose, note):
    """One node's, while it is fed."""
    name, graph_fuzz.SEED = choose.choice(sorted(graph_fuzz.NODES)), choose.randrange(10 ** 6)
    note((name, graph_fuzz.SEED))
    graph_fuzz.test_node_fed_messages_of_any_content_lives_on_and_is_no_larger(Car(), name)


def services(choose, note):
    name, graph_fuzz.SEED = choose.choice(graph_fuzz.SERVING), choose.randrange(10 ** 6)
    note((name, graph_fuzz.SEED))
    graph_fuzz.test_node_asked_anything_by_its_services_answers_in_words(Car(), name)


def serial(choose, note):
    """Bytes in both directions, between those of the virtual Teensy."""
    car = Car()
    car.sim()
    node = car.hub()
    car.graph.run(0.5)
    for _ in range(50):
        data = line_fuzz.mutated(choose)
        note(data)
        car.cable.to_computer(data)
        if choose.random() < 0.3 and car.cable.terminal is not None:
            car.cable.terminal.take(data)
        car.graph.run(choose.choice((0.0, 0.003, 0.05)))
        check(node.is_alive and car.graph.nodes["/car_sim"].is_alive, node.fault)


def result_of(path):
    with suppress(ValueError), open(path, encoding="utf-8", errors="replace") as file:
        calibration_result.parsed(file.read())


def messages_of(path):
    for _ in recording.read(path, recording.contents(path).topics):
        pass


SIDE = [[0.5, 3800, 3800.0, 1.0, 2.0, 3, 0.1, "driven"]]
RESULT = json.dumps(["", ["line"], ["step"], [0.5], SIDE, SIDE, [5100, 5090], [[5000, 0.1]], [[5000, 0.1, 0.01]],
                     [[5000, 0.1]]]).encode()
FILES = {  # its content, and what reads it
    "turn_arb.yaml": load_steering, "throttle.yaml": load_throttle, "pca9685.yaml": load_yaml, "sonars.yaml": load_yaml,
    "gamepads.yaml": lambda path: load_entries(os.path.dirname(path)), "value_map.csv": load_value_map,
    "result.json": result_of, "drive.bag": messages_of, "drive.mcap": messages_of}


def good_files(folder):
    """Return the content of a good file by the names of FILES."""
    bag = os.path.join(folder, "good.bag")
    import rosbag
    with rosbag.Bag(bag, "w") as writer:
        for number in range(20):
            writer.write("/servo/output", Int32MultiArray(data=[number] * 16), rospy.Time(1000 + number))
    more = {"result.json": RESULT, "drive.bag": Path(bag).read_bytes(),
            "drive.mcap": (TEST / "data/autoware_mcap/autoware_mcap.mcap").read_bytes()}
    return {name: more[name] if name in more else (CONFIG / name).read_bytes() for name in FILES}


def files(choose, note):
    name = choose.choice(sorted(FILES))
    with tempfile.TemporaryDirectory() as folder:
        files.good = files.good or good_files(folder)
        path, data = os.path.join(folder, name), damaged(files.good[name], choose)
        note((name, data if len(data) < 2000 else f"{len(data)} bytes"))
        Path(path).write_bytes(data)
        try:
            FILES[name](path)
        except CarInterfaceError as error:
            check_line(error)


files.good = {}


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
        controls = core.phones.controls(time.monotonic_ns())
        check(core.thread.is_alive() and not controls.manual, f"{core.thread}, {controls}")
    finally:
        core.stop()


HEADER = {"callerid": "/peer", "topic": "/servo/output", "type": "*", "md5sum": "*", "tcp_nodelay": "1"}
CALLS = ("getPid", "getBusInfo", "getBusStats", "getSubscriptions", "requestTopic", "paramUpdate", "nonsense", "_dispatch")


def peers(choose, note):
    """At a node's two ports: half a header, another one, none, one of 4 GB, XML that isn't, and silence."""
    node = choose.choice(NODES)
    uri = rosgraph.Master("/fuzz").lookupNode(node)
    topic = choose.choice(ask(node, "getPublications"))[0]
    fields = {**HEADER, "topic": topic, choose.choice(list(HEADER)): choose.choice(graph_fuzz.TEXTS)}
    body = b"".join(struct.pack("<I", len(each)) + each for each in (f"{k}={v}".encode() for k, v in fields.items()))
    request = xmlrpc.client.dumps(("/peer", *(graph_fuzz.any_value(choose, False) for _ in range(choose.randrange(4)))),
                                  choose.choice(CALLS), allow_none=True).encode("utf-8", "replace")
    http = b"POST / HTTP/1.1\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n" % len(request) + request
    is_tcpros = choose.random() < 0.6
    data = damaged(struct.pack("<I", choose.choice((len(body),) * 4 + (0, 2 ** 32 - 1))) + body if is_tcpros else http,
                   choose)
    note((node, "TCPROS" if is_tcpros else "XMLRPC", data))
    port = ask(node, "requestTopic", topic, [["TCPROS"]])[2] if is_tcpros else int(uri.rstrip("/").rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), 5) as peer, suppress(OSError):
        for start in range(0, len(data), max(1, len(data) // choose.choice((1, 1, 5)))):
            peer.sendall(data[start:start + max(1, len(data) // 5)])
        peer.settimeout(choose.choice((0.01, 0.1)))
        peer.recv(4096)
    check(ask(node, "getPid") is not None, f"{node} answers no more")


KINDS = {kind.__name__: kind for kind in (peers, messages, parameters, files, serial, phone, services, memory)}


class Fuzz:
    """The cases of a run, and what they found."""

    def __init__(self, seed: int):
        self._seed, self._counts, self._input, self._errors = seed, Counter(), None, []
        self.found = 0
        threading.excepthook = lambda args: self._errors.append(repr(args.exc_value))
        handler = logging.Handler(logging.WARNING)
        handler.emit = lambda record: self._errors.append(record.getMessage()) if record.exc_info else None
        logging.getLogger().addHandler(handler)

    def report(self, kind: str, seed: object, what: object) -> None:
        self.found += 1
        text = repr(self._input)
        print(f"FOUND {kind}, seed {seed}: {what}\n  input {text[:MAX_SHOWN]}{'…' * (len(text) > MAX_SHOWN)}", flush=True)

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
        begun_s, before = time.monotonic(), {}
        for kind in cycle(kinds):
            until_s = min(time.monotonic() + CASES_S, begun_s + 60 * minutes)
            self.one(kind)
            while time.monotonic() < until_s:
                self.one(kind)
            passed = (time.monotonic() - begun_s) / (60 * minutes) if minutes else 1
            if passed >= 1 and set(self._counts) >= set(kinds):
                break
            if passed > 0.4 and not before:
                time.sleep(SETTLE_S)
                before = {node: footprint(node) for node in NODES}
        time.sleep(SETTLE_S if before else 0)
        self._input = None
        for node in before:
            after = footprint(node)
            if before[node].has_grown_until(after):
                self.report("peers", self._seed, f"{node} has grown: {before[node]}, then {after}")
        print(", ".join(f"{kind} {count}" for kind, count in self._counts.items()))


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
    log = Path(os.environ["ROS_LOG_DIR"]) / "roslaunch.log"
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    for number in [number for number, line in enumerate(lines) if "Traceback" in line][:5]:
        fuzz.report("peers", arguments.seed, "traceback in a node's log: " + " | ".join(lines[number:number + 20]))
    print(f"found {fuzz.found}")
    return 1 if fuzz.found else 0


if __name__ == "__main__":
    sys.exit(main())
