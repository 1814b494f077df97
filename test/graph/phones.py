"""Phones for phone_drive, at the border of its server: what is sent on a connection, and when it arrives."""
from __future__ import annotations

import itertools
import json
import os
from functools import partial
from typing import Any

from car_interface.nodes.phone_drive.node import PhoneDrive
from graph import Graph, Node

PIN = "271828"


class Network:
    """What ``server.Server`` is to the node: connections, and the way to them.

    Attributes:
        delay_s: called for each message; how long it takes. None overtakes another one of its connection.
    """

    def __init__(self, graph: Graph):
        self.graph = graph
        self.delay_s = lambda: 0.02
        self.phones: dict[int, Phone] = {}
        self._numbers = itertools.count(1)
        self._arrivals_ns: dict[tuple, int] = {}

    def add_node(self, name: str = "phone_drive", make: dict | None = None, **parameters: Any) -> Node:
        """Start phone_drive, with other makers than its own."""
        return self.graph.add(partial(PhoneDrive, make_server=self._start, **(make or {})), name,
                              {"pin": PIN, **parameters})

    def _start(self, config, inbox, rules):
        self.phones = {}
        self._inbox, self._rules = inbox, rules
        return self

    def send(self, outgoing) -> None:
        phone = self.phones.get(outgoing.connection)
        if phone is not None:
            self.carry((outgoing.connection, "out"), lambda: phone.take(outgoing))

    def offer(self, path: str) -> str:
        return f"/files/ticket/{os.path.basename(path)}"

    def stop(self) -> None:
        self.phones = {}

    def connect(self, phone: Phone) -> int:
        number = next(self._numbers)
        self.phones[number] = phone
        self._put(number, lambda rules, now_ns: rules.connect(number, phone.address, now_ns))
        return number

    def to_node(self, number: int, text: str) -> None:
        self._put(number, lambda rules, now_ns: rules.receive(number, text, now_ns), lambda: number in self.phones)

    def disconnect(self, number: int) -> None:
        """End a connection so that the node learns of it."""
        self.phones.pop(number, None)
        self._put(number, lambda rules, now_ns: rules.disconnect(number))

    def _put(self, number, tell, arrives=lambda: True) -> None:
        """Have this start of the node told what happens on a connection."""
        inbox, rules = self._inbox, self._rules
        self.carry((number, "in"), lambda: arrives() and inbox.put(tell, rules))

    def carry(self, way, arrive) -> None:
        at_ns = max(self.graph.now_ns + round(self.delay_s() * 1e9), self._arrivals_ns.get(way, 0))
        self._arrivals_ns[way] = at_ns
        self.graph.at(at_ns, arrive)


class Phone:
    """A page, and the thumbs on it.

    Attributes:
        touch, steering, throttle: what is touched now.
        is_frozen: it handles nothing, and then all at once.
        is_cut: nothing gets through, and nobody learns of it.
        touched_ns: when it last sent an echo of a touch.
    """

    def __init__(self, network: Network, address: str = "10.0.0.7", is_guest: bool = False):
        self._network, self.address, self._is_guest = network, address, is_guest
        self.touch, self.steering, self.throttle, self.scale = "", 0.0, 0.0, 0
        self.is_frozen = self.is_cut = False
        self.key = ""
        self.touched_ns = 0
        self.sent: list[str] = []
        self._held_back: list = []
        self.connect()

    def connect(self) -> None:
        """Load the page: nothing is known of an earlier one but the key."""
        self.token, self.n, self.status, self.closed, self.refused, self.done, self.file = "", 0, {}, "", "", "", ""
        self.car: dict = {}
        self.number = self._network.connect(self)
        self.send(**({"type": "watch"} if self._is_guest else {"type": "key", "key": self.key} if self.key else
                     {"type": "pin", "pin": PIN}))

    def reload(self) -> None:
        self._network.disconnect(self.number)
        self.connect()

    def take(self, outgoing) -> None:
        if outgoing.connection != self.number or self.is_cut:
            return
        if self.is_frozen:
            self._held_back.append(outgoing)
            return
        message = json.loads(outgoing.text)
        for name in ("key", "status", "closed", "refused", "done", "file"):
            setattr(self, name, message.get(name, getattr(self, name)))
        self.car.update(message.get("car", {}))
        if "token" in message:
            self.token = message["token"]
            self.echo()

    def thaw(self) -> None:
        self.is_frozen = False
        held_back, self._held_back = self._held_back, []
        for outgoing in held_back:
            self.take(outgoing)

    def echo(self) -> None:
        if self.touch and not self.is_cut:
            self.touched_ns = self._network.graph.now_ns
        self.evidence("echo", touch=self.touch, steering=self.steering, throttle=self.throttle, scale=self.scale)

    def hold(self, touch: str, steering: float = 0.0, throttle: float = 0.0) -> None:
        self.touch, self.steering, self.throttle = touch, steering, throttle
        self.echo()

    def evidence(self, kind: str, **fields) -> None:
        self.n += 1
        self.send(type=kind, token=self.token, n=self.n, **fields)

    def send(self, **message) -> None:
        self.send_text(json.dumps(message))

    def send_text(self, text: str) -> None:
        if not self.is_cut:
            self.sent.append(text)
            self._network.to_node(self.number, text)
