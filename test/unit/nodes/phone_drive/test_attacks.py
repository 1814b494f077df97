"""What strangers do to phone_drive's server and rules on a real network, while a phone drives: nothing of it counts."""
import asyncio
import json
import os
import queue
import random
import socket
import threading
import time
import tracemalloc
from contextlib import suppress

import pytest
from processes import free_port

pytest.importorskip("tornado")
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.iostream import StreamClosedError
from tornado.websocket import WebSocketClosedError, websocket_connect

from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.nodes.phone_drive.server import MAX_CLOSING, MAX_SOCKETS, MAX_UNHANDLED, Server
from car_interface.teleop.phone import MAX_PAGES, MAX_WAITING, Phones

PIN = "314159"
FRAMES = 100_000 if os.environ.get("CAR_INTERFACE_ALL") else 1000
FRAMES_PER_CONNECTION = 40
# How late a thread of this process is: then the machine, and not the attack, may have stopped the driver. From a token
# to its echo's effect a message waits for five threads.
LATE_S = 0.05
CLOSED = (WebSocketClosedError, StreamClosedError, HTTPClientError, OSError)


class Core:
    """The rules, in a thread as the node's, behind a real server."""

    def __init__(self, port):
        self.port, self.items = port, queue.Queue()
        self.phones = Phones(PIN, time.monotonic_ns())
        self.latest_s, self.is_over = 0.0, False
        self.server = Server(PhoneDriveConfig(port=port), self, self.phones)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def put(self, handler, item, wakes=True, on_drop=None):
        self.items.put((handler, item))

    def _run(self):
        while not self.is_over:
            due_s = max(0.0, (self.phones.due_ns - time.monotonic_ns()) / 1e9)
            with suppress(queue.Empty):
                handler, item = self.items.get(timeout=due_s)
                handler(item, time.monotonic_ns())
            self.latest_s = max(self.latest_s, (time.monotonic_ns() - self.phones.due_ns) / 1e9)
            self.phones.step(time.monotonic_ns())
            for outgoing in self.phones.drain():
                self.server.send(outgoing)

    def stop(self):
        self.is_over = True
        self.thread.join()
        self.server.stop()


@pytest.fixture
def core():
    core = Core(free_port())
    yield core
    core.stop()


def connect(core):
    headers = {"Origin": f"http://127.0.0.1:{core.port}"}
    return websocket_connect(HTTPRequest(f"ws://127.0.0.1:{core.port}/ws", headers=headers, request_timeout=20))


class Driver:
    """A phone that drives from beginning to end, touching all the time."""

    def __init__(self, core):
        self._core, self.touch, self.status, self.closed, self.n = core, "", {}, "", 0
        self._token, self.latest_s = "", 0.0

    async def __aenter__(self):
        self._link = await connect(self._core)
        await self._link.write_message(json.dumps({"type": "pin", "pin": PIN}))
        self._tasks = [asyncio.ensure_future(self._echo()), asyncio.ensure_future(self._watch())]
        await self._until(lambda: self.status and self._token)
        await self._until(lambda: self.status["driver"] == "you" and not self.status["why"], self._drive)
        await self._until(self._is_obeyed, self._hold)
        self.losses, self._core.latest_s, self.latest_s = self._core.phones.counts["loss"], 0.0, 0.0
        return self

    async def __aexit__(self, *_):
        for task in self._tasks:
            task.cancel()
        self._link.close()

    def check(self):
        """The driver drives on; a touch that was lost needs a late machine."""
        assert self.closed == "" and self.status["driver"] == "you" and not self.status["e_stop"]
        is_late = max(self.latest_s, self._core.latest_s) > LATE_S
        assert self._core.phones.counts["loss"] == self.losses and self._is_obeyed() or is_late

    def _is_obeyed(self):
        return self._core.phones.controls(time.monotonic_ns()).manual

    async def _until(self, condition, press=None):
        """Wait; press again each second, as a person would: what a machine that stood still sent is too old."""
        for poll in range(1000):
            if condition():
                return
            if press is not None and poll % 50 == 0:
                await press()
            await asyncio.sleep(0.02)
        raise AssertionError(f"not within 20 s: {self.status}")

    async def _drive(self):
        await self._send("drive")

    async def _hold(self):
        self.touch = ""
        await asyncio.sleep(0.1)
        self.touch = "manual"

    async def _send(self, kind, **fields):
        self.n += 1
        await self._link.write_message(json.dumps({"type": kind, "token": self._token, "n": self.n, **fields}))

    async def _watch(self):
        while True:
            before_s = time.monotonic()
            await asyncio.sleep(0.01)
            self.latest_s = max(self.latest_s, time.monotonic() - before_s - 0.01)

    async def _echo(self):
        while True:
            text = await self._link.read_message()
            if text is None:
                self.closed = self.closed or "closed"
                return
            message = json.loads(text)
            self.status, self.closed = message.get("status", self.status), message.get("closed", self.closed)
            if "token" in message:
                self._token = message["token"]
                await self._send("echo", touch=self.touch, steering=0.1, throttle=0.1, scale=0)


def under_attack(core, attack):
    """Drive while a coroutine attacks; return what it returns."""
    async def run():
        async with Driver(core) as driver:
            result = await attack(core)
            await asyncio.sleep(0.3)
            driver.check()
            return result
    return asyncio.run(run())


def beside(function, *arguments):
    """Run what blocks in another thread than the driver's page."""
    return asyncio.get_running_loop().run_in_executor(None, function, *arguments)


async def flood(core, messages, binary=False):
    """Send messages on a connection of its own, until it is closed; return what came."""
    with suppress(*CLOSED):
        link = await connect(core)
        for message in messages:
            await link.write_message(message, binary=binary)
            await asyncio.sleep(0)
        link.close()


def test_200_websockets_without_a_pin_are_closed_and_nothing_of_them_stays(core):
    async def attack(core):
        raw = [await beside(socket.create_connection, ("127.0.0.1", core.port)) for _ in range(200)]
        for each in raw:  # it doesn't answer to a close either
            with suppress(OSError):
                each.sendall(upgrade(core))
            await asyncio.sleep(0.002)
        await asyncio.sleep(0.5)
        count = len(core.server.sockets)
        for each in raw:
            each.close()
        return count
    assert under_attack(core, attack) <= 1 + MAX_WAITING + MAX_CLOSING < MAX_SOCKETS
    assert len(core.phones._pages) <= MAX_WAITING + 1


def test_frames_of_10_mb_end_their_connections(core):
    frame = b"\x81\xff" + (10_000_000).to_bytes(8, "big") + bytes(10_000_004)

    def send():
        with socket.create_connection(("127.0.0.1", core.port)) as raw, suppress(OSError):
            raw.sendall(upgrade(core) + frame)
            raise AssertionError("it was taken whole")

    async def attack(core):
        for _ in range(5):
            await beside(send)
        return tracemalloc.get_traced_memory()[1]
    tracemalloc.start()
    assert under_attack(core, attack) < 30_000_000  # of which the sender's frame is 10 and its copy 10
    tracemalloc.stop()


def test_frame_that_announces_what_never_comes_is_not_waited_for_in_memory(core):
    async def attack(core):
        with socket.create_connection(("127.0.0.1", core.port)) as raw:
            raw.sendall(upgrade(core) + b"\x81\xff" + (2 ** 40).to_bytes(8, "big") + bytes(4))
            raw.settimeout(10)
            while await beside(raw.recv, 4096):
                pass  # it ends
    under_attack(core, attack)


def test_pings_that_nobody_takes_the_answers_of_end_their_connection(core):
    async def attack(core):
        with socket.create_connection(("127.0.0.1", core.port)) as raw, suppress(OSError):
            raw.sendall(upgrade(core))
            raw.settimeout(10)
            for _ in range(2000):
                await beside(raw.sendall, b"\x89\xfd" + bytes(4) + bytes(125))
            raise AssertionError("it goes on")
    under_attack(core, attack)


def upgrade(core):
    return (f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{core.port}\r\nOrigin: http://127.0.0.1:{core.port}\r\n"
            "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n").encode()


VALID = [{"type": "echo", "token": "t", "n": 1, "touch": "manual", "steering": 0.0, "throttle": 1, "scale": 0},
         {"type": "drive", "token": "t", "n": 1}, {"type": "clear", "token": "t", "n": 2}, {"type": "key", "key": "k"},
         {"type": "trim", "token": "t", "n": 1, "name": "center", "value": 5000}, {"type": "leave"},
         {"type": "open", "name": "../../etc/passwd"}, {"type": "record", "token": "t", "n": 1, "on": True}]
ODD = [None, True, -1, 1e308, 2 ** 70, "", "x" * 70, "manual", [], {}, "\ud800", "\0", "../x.bag", float("nan")]


def malformed(rng):
    """A message of a page, changed at random."""
    message = dict(rng.choice(VALID))
    for _ in range(rng.randint(0, 3)):
        message[rng.choice([*message, "more", "type"])] = rng.choice(ODD)
    text = json.dumps(message)
    for _ in range(rng.randint(0, 4)):
        at = rng.randrange(len(text) + 1)
        instead = rng.choice(["", '"', "{", "}", "[" * 30, "\\u", "9" * 30, "é"])
        text = text[:at] + instead + text[at + rng.randint(0, 3):]
    return text


def test_malformed_frames_are_refused(core):
    rng = random.Random(5)

    async def attack(core):
        for _ in range(FRAMES // FRAMES_PER_CONNECTION):
            await flood(core, [malformed(rng) for _ in range(FRAMES_PER_CONNECTION)])
        await flood(core, [bytes(rng.getrandbits(8) for _ in range(50))] * 30, binary=True)
    under_attack(core, attack)
    assert core.phones.counts["malformed"] > FRAMES / 10
    assert len(core.phones._pages) <= MAX_PAGES + MAX_WAITING and not core.phones.e_stop
    assert sum(map(unhandled, core.server.sockets.values())) < 200 and len(core.server.sockets) < MAX_SOCKETS


def unhandled(connection):
    """How many of its messages the node has not handled."""
    free = sum(1 for _ in iter(lambda: connection.room.acquire(blocking=False), False))
    return MAX_UNHANDLED - free


def test_bytes_that_are_no_http_or_no_frame_are_refused(core):
    rng = random.Random(6)

    async def attack(core):
        for count in range(FRAMES // 20):
            with socket.create_connection(("127.0.0.1", core.port)) as raw, suppress(OSError):
                raw.sendall((upgrade(core) if count % 2 else b"") + bytes(rng.choices(range(256), k=300)))
            await asyncio.sleep(0)
    under_attack(core, attack)
