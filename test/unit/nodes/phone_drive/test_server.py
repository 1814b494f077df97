"""phone_drive's server: what gets through between a socket and the node's inbox, and what is refused."""
from __future__ import annotations

import asyncio
import http.client
import json
import queue
import socket
from contextlib import suppress

import pytest

pytest.importorskip("tornado")
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

from car_interface.common.errors import DeviceError
from car_interface.nodes.phone_drive import server as phone_server
from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.nodes.phone_drive.server import MAX_BYTES, MAX_OPEN, MAX_UNHANDLED, Server
from car_interface.teleop.phone import Outgoing

WITHIN_S = 30


class Node:
    """Its inbox and its handlers, which keep what arrives."""

    def __init__(self):
        self.events = queue.Queue()
        self.items = []
        self.handles = True

    def put(self, handler, item, wakes=True, on_drop=None):
        if self.handles:
            handler(item, 0)
        else:
            self.items.append((handler, item))

    def on_connect(self, item, now_ns):
        self.events.put(("connect", *item))

    def on_message(self, item, now_ns):
        self.events.put(("message", *item))

    def on_disconnect(self, number, now_ns):
        self.events.put(("disconnect", number))

    def next(self):
        return self.events.get(timeout=WITHIN_S)


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def node():
    return Node()


@pytest.fixture
def server(node, port, monkeypatch):
    monkeypatch.setattr(phone_server, "HEADER_S", 3600)  # no test waits until silence ends a connection
    server = Server(PhoneDriveConfig(port=port), node, node)
    yield server
    server.stop()


async def connect(port, origin=None, host=None):
    headers = {"Origin": f"http://127.0.0.1:{port}" if origin is None else origin, "Host": host}
    given = {name: value for name, value in headers.items() if value}
    return await websocket_connect(HTTPRequest(f"ws://127.0.0.1:{port}/ws", headers=given))


def test_texts_pass_both_ways_and_a_closed_page_is_reported(server, node, port):
    async def page():
        link = await connect(port)
        assert node.next() == ("connect", 1, "127.0.0.1")
        await link.write_message('{"type": "leave"}')
        assert await asyncio.get_event_loop().run_in_executor(None, node.next) == ("message", 1, '{"type": "leave"}')
        server.send(Outgoing(1, '{"token":"a"}'))
        server.send(Outgoing(1, '{"closed":"why"}', closes=True))
        assert [await link.read_message() for _ in range(3)] == ['{"token":"a"}', '{"closed":"why"}', None]
    asyncio.run(page())
    assert node.next() == ("disconnect", 1)


@pytest.mark.parametrize("origin, host", [
    ("http://evil.example", None), ("null", None), ("", None), ("http://127.0.0.1:1", None),
    ("http://evil.example:{port}", "evil.example:{port}"), (None, "evil.example:{port}"), (None, "127.0.0.1"),
], ids=["other_origin", "sandbox", "no_origin", "other_port", "dns_rebinding", "other_host", "host_without_port"])
def test_page_of_another_origin_or_under_another_name_gets_no_connection(server, node, port, origin, host):
    with pytest.raises(HTTPClientError, match="403"):
        asyncio.run(connect(port, origin and origin.format(port=port), host and host.format(port=port)))
    assert node.events.empty()


def ask(port, path, host=None, method="GET"):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WITHIN_S)
    connection.request(method, path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    return answer.status, answer.read(), dict(answer.getheaders())


@pytest.mark.parametrize("path", ["/", "/../../etc/passwd", "/%2e%2e/etc/passwd", "/ws/../x", "/<script>", "//x"])
def test_any_other_path_is_not_found_and_has_a_strict_policy(server, port, path):
    status, body, headers = ask(port, path)
    assert (status, body) == (404, b"404\n")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'; ")
    assert (headers["X-Content-Type-Options"], headers["Referrer-Policy"]) == ("nosniff", "no-referrer")
    assert ask(port, path, "evil.example")[0] == 403


def test_message_that_is_too_long_ends_its_connection(server, node, port):
    async def page():
        link = await connect(port)
        await link.write_message("x" * (MAX_BYTES + 1))
        return await link.read_message()
    assert asyncio.run(page()) is None
    assert [node.next()[0], node.next()[0]] == ["connect", "disconnect"]


def test_page_that_sends_faster_than_the_node_handles_is_closed(server, node, port):
    async def page():
        link = await connect(port)
        node.next()
        node.handles = False
        with suppress(WebSocketClosedError):
            for _ in range(3 * MAX_UNHANDLED):
                await link.write_message("x")
        return await link.read_message()
    assert asyncio.run(page()) is None
    assert len(node.items) <= MAX_UNHANDLED + 1


def test_page_that_takes_nothing_is_closed(server, node, port):
    with socket.create_connection(("127.0.0.1", port)) as page:
        page.sendall((f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n"
                      "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                      "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n").encode())
        node.next()
        for _ in range(1000):
            server.send(Outgoing(1, json.dumps("x" * 100_000)))
        assert node.next() == ("disconnect", 1)


def test_connections_that_ask_for_nothing_keep_no_page_out(server, node, port):
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(MAX_OPEN + 136)]
    asyncio.run(connect(port))
    assert node.next()[0] == "connect"
    for each in silent:
        each.close()


def test_address_that_is_taken_is_an_error_that_names_it(server, node, port):
    with pytest.raises(DeviceError, match=f"~port {port}: .*Set another address"):
        Server(PhoneDriveConfig(port=port), node, node)
