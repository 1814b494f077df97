"""phone_drive's server: what gets through between a socket and the node's inbox, and what is refused."""
import asyncio
import http.client
import json
import os
import queue
import re
import shutil
import socket
import ssl
import subprocess
import threading
import time
from contextlib import suppress

import pytest
from processes import free_port

pytest.importorskip("tornado")
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClosedError, websocket_connect

from car_interface.common.errors import ConfigError, DeviceError
from car_interface.nodes.phone_drive import server as phone_server
from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.nodes.phone_drive.server import (
    MAX_BYTES,
    MAX_DOWNLOADS,
    MAX_OPEN,
    MAX_TICKETS,
    MAX_UNHANDLED,
    PAGE,
    Server,
)
from car_interface.teleop.phone import Outgoing

WITHIN_S = 30


class Node:
    """Its inbox and its rules, which keep what arrives."""

    def __init__(self):
        self.events = queue.Queue()
        self.items = []
        self.handles = True

    def put(self, handler, item, wakes=True, on_drop=None):
        if self.handles:
            handler(item, 0)
        else:
            self.items.append((handler, item))

    def connect(self, number, address, now_ns):
        self.events.put(("connect", number, address))

    def receive(self, number, data, now_ns):
        self.events.put(("message", number, data))

    def disconnect(self, number):
        self.events.put(("disconnect", number))

    def next(self):
        return self.events.get(timeout=WITHIN_S)


@pytest.fixture
def port():
    return free_port()


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
    ("https://127.0.0.1:{port}", None), ("http://evil.example:{port}", "evil.example:{port}"),
    (None, "evil.example:{port}"), (None, "127.0.0.1"),
], ids=["other_origin", "sandbox", "no_origin", "other_port", "https", "dns_rebinding", "other_host",
        "host_without_port"])
def test_page_of_another_origin_or_under_another_name_gets_no_connection(server, node, port, origin, host):
    with pytest.raises(HTTPClientError, match="403"):
        asyncio.run(connect(port, origin and origin.format(port=port), host and host.format(port=port)))
    assert node.events.empty()


def ask(port, path, host=None, method="GET"):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WITHIN_S)
    connection.request(method, path, headers={"Host": host or f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    return answer.status, answer.read(), dict(answer.getheaders())


@pytest.mark.parametrize("path", ["/", *(f"/{path.name}" for path in PAGE.iterdir())])
def test_page_is_whole_and_may_load_and_connect_to_its_own_server_only(server, port, path):
    status, body, headers = ask(port, path)
    assert (status, body) == (200, (PAGE / (path[1:] or "index.html")).read_bytes())
    assert set(re.findall(r"[-\w]+:(?://)?[^; ]*|'[-\w]+'", headers["Content-Security-Policy"])) == {
        "'none'", "'self'", f"ws://127.0.0.1:{port}", f"wss://127.0.0.1:{port}"}
    text = body.replace(b"http://www.w3.org", b"")
    assert not re.search(rb"(?:https?:)?//[a-z]+[.]|style=|\son[a-z]+=|<script>", text)
    assert ask(port, path, "evil.example")[0] == 403


@pytest.mark.parametrize("path", ["/x", "/../../etc/passwd", "/%2e%2e/etc/passwd", "/ws/../x", "/<script>", "//x"])
def test_any_other_path_is_not_found_and_has_a_strict_policy(server, port, path):
    status, body, headers = ask(port, path)
    assert (status, body.split()[0]) == (404, b"404.") and b"script" not in body
    assert headers["Content-Security-Policy"].startswith("default-src 'none'; ")
    assert (headers["X-Content-Type-Options"], headers["Referrer-Policy"]) == ("nosniff", "no-referrer")
    assert ask(port, path, "evil.example")[0] == 403


def test_page_is_served_with_a_policy_that_names_its_own_address(node, port, tmp_path, monkeypatch):
    (tmp_path / "index.html").write_bytes(b"page")
    (tmp_path / "secret.txt").write_bytes(b"secret")
    monkeypatch.setattr("car_interface.nodes.phone_drive.server.PAGE", tmp_path)
    server = Server(PhoneDriveConfig(port=port), node, node)
    status, body, headers = ask(port, "/", f"localhost:{port}")
    assert (status, body, ask(port, "/secret.txt")[0]) == (200, b"page", 404)
    server.stop()
    assert f"connect-src 'self' ws://localhost:{port} " in headers["Content-Security-Policy"]


# --- files ---

def test_report_is_served_once_in_a_sandbox_and_a_recording_to_be_saved(server, port, tmp_path):
    for name, content in (("a.html", b"<script>alert(1)</script>"), ("a.bag", bytes(200_000))):
        (tmp_path / name).write_bytes(content)
        path = server.offer(str(tmp_path / name))
        status, body, headers = ask(port, path)
        assert (status, body) == (200, content)
        if name == "a.html":
            policy = headers["Content-Security-Policy"]
            assert policy.startswith("sandbox; default-src 'none'; ") and "allow-" not in policy
            assert "script-src" not in policy
        else:
            assert headers["Content-Disposition"] == 'attachment; filename="a.bag"'
            assert headers["Content-Type"] == "application/octet-stream"
        assert headers["Cache-Control"] == "no-store" and headers["X-Content-Type-Options"] == "nosniff"
        assert ask(port, path)[0] == 404


@pytest.mark.parametrize("path", ["/files/x/a.bag", "/files/../../etc/passwd", "/files/x/..%2f..%2fetc/passwd",
                                  "/files//etc/passwd", "/files/{ticket}/../../../etc/passwd"])
def test_file_without_a_ticket_and_a_path_with_dots_are_refused(server, port, tmp_path, path):
    (tmp_path / "a.bag").write_bytes(b"a")
    ticket = server.offer(str(tmp_path / "a.bag")).split("/")[2]
    assert ask(port, path.format(ticket=ticket))[0] == 404


def test_ticket_is_for_a_minute_and_the_newest_16_count(server, port, tmp_path, monkeypatch):
    (tmp_path / "a.bag").write_bytes(b"a")
    paths = [server.offer(str(tmp_path / "a.bag")) for _ in range(MAX_TICKETS + 1)]
    assert [ask(port, path)[0] for path in (paths[0], paths[1])] == [404, 200]
    monkeypatch.setattr("car_interface.nodes.phone_drive.server.TICKET_S", 0)
    assert ask(port, server.offer(str(tmp_path / "a.bag")))[0] == 404
    (tmp_path / "a.bag").unlink()
    assert ask(port, paths[2])[0] == 404


def test_downloads_that_nobody_takes_end_and_make_room(server, port, tmp_path, monkeypatch):
    monkeypatch.setattr(phone_server, "CHUNK_S", 0.2)
    (tmp_path / "a.bag").write_bytes(bytes(50_000_000))  # more than the sockets' buffers
    slow = []
    for _ in range(MAX_DOWNLOADS):
        path = server.offer(str(tmp_path / "a.bag"))
        slow.append(socket.create_connection(("127.0.0.1", port)))
        slow[-1].sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    deadline_s = time.monotonic() + WITHIN_S
    while len(server.downloads) < MAX_DOWNLOADS and time.monotonic() < deadline_s:
        time.sleep(0.01)
    while server.downloads and time.monotonic() < deadline_s:
        time.sleep(0.01)
    monkeypatch.undo()  # a busy computer may not take a chunk in 0.2 s
    assert ask(port, server.offer(str(tmp_path / "a.bag")))[0] == 200
    for each in slow:
        each.close()


def test_download_goes_on_while_others_connect_and_ask_for_nothing(server, port, tmp_path):
    size = 50_000_000  # more than the sockets' buffers
    (tmp_path / "a.bag").write_bytes(bytes(size))
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=WITHIN_S)
    connection.request("GET", server.offer(str(tmp_path / "a.bag")), headers={"Host": f"127.0.0.1:{port}"})
    answer = connection.getresponse()
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(2 * MAX_OPEN)]
    asyncio.run(connect(port))  # so all of them were taken
    assert len(answer.read()) == size
    for each in silent:
        each.close()


# --- TLS ---

@pytest.fixture
def certificate(tmp_path):
    openssl = shutil.which("openssl") or pytest.skip("there is no openssl to make a certificate with")
    files = tmp_path / "car.pem", tmp_path / "car.key"
    subprocess.run([openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-subj", "/CN=car", "-addext", "subjectAltName=IP:127.0.0.1", "-out", files[0], "-keyout",
                    files[1]], check=True, capture_output=True)
    return tuple(map(str, files))


def test_page_is_https_with_a_certificate_and_takes_no_origin_of_http(node, port, certificate):
    server = Server(PhoneDriveConfig(port=port, certificate=certificate[0], key=certificate[1]), node, node)
    trusting = ssl.create_default_context(cafile=certificate[0])

    async def page(origin):
        request = HTTPRequest(f"wss://127.0.0.1:{port}/ws", headers={"Origin": f"{origin}://127.0.0.1:{port}"},
                              ssl_options=trusting)
        return await websocket_connect(request)
    try:
        asyncio.run(page("https"))
        assert node.next()[0] == "connect"
        with pytest.raises(HTTPClientError, match="403"):
            asyncio.run(page("http"))
        with pytest.raises(OSError):
            ask(port, "/")
    finally:
        server.stop()


def test_certificate_that_can_t_be_used_is_an_error_that_names_it(node, port, certificate):
    with pytest.raises(ConfigError, match=r"^certificate is '/.*; accepted: a PEM file with ~key /.*car\.key"):
        Server(PhoneDriveConfig(port=port, certificate=certificate[1], key=certificate[1]), node, node)
    encrypted = f"{certificate[1]}.encrypted"
    subprocess.run(["openssl", "pkey", "-in", certificate[1], "-aes128", "-passout", "pass:secret", "-out", encrypted],
                   check=True, capture_output=True)
    with pytest.raises(ConfigError, match="which needs no password"):  # and the terminal isn't asked for one
        Server(PhoneDriveConfig(port=port, certificate=certificate[0], key=encrypted), node, node)
    pipe = f"{certificate[0]}.pipe"
    os.mkfifo(pipe)
    for files in ((pipe, certificate[1]), (certificate[0], pipe)):  # nobody writes to it, and nothing waits for that
        with pytest.raises(ConfigError, match=r"\(.*it is a pipe\)"):
            Server(PhoneDriveConfig(port=port, certificate=files[0], key=files[1]), node, node)
    with pytest.raises(ConfigError, match=r"^key is missing; accepted: both a certificate"):
        PhoneDriveConfig(certificate=certificate[0])


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
    for each in silent[::2]:
        each.sendall(b"GET /ws HTTP/1.1\r\nHost: ")
    asyncio.run(connect(port))
    assert node.next()[0] == "connect"
    for each in silent:
        each.close()


def test_stop_ends_what_waits_for_a_request(node, port):
    server = Server(PhoneDriveConfig(port=port), node, node)
    with socket.create_connection(("127.0.0.1", port)):
        asyncio.run(connect(port))  # so the other one was taken
        server.stop()
    assert not asyncio.all_tasks(server.loop)  # asyncio would print each of them


@pytest.mark.parametrize("goes_on", [True, False])
def test_stop_ends_a_download(node, port, tmp_path, caplog, goes_on):
    with open(tmp_path / "a.bag", "wb") as file:
        file.truncate(10 ** 10)  # a hole
    server = Server(PhoneDriveConfig(port=port), node, node)
    with socket.create_connection(("127.0.0.1", port)) as page:
        path = server.offer(str(tmp_path / "a.bag"))
        page.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
        assert page.recv(65536)
        reader = threading.Thread(target=lambda: [None for _ in iter(lambda: _received(page), b"")], daemon=True)
        if goes_on:
            reader.start()
        time.sleep(0.1)  # so that it is under way, or its buffers are full
        server.stop()
        assert not server._thread.is_alive() and not server.downloads
    if goes_on:
        reader.join(WITHIN_S)
    assert not caplog.records  # asyncio would print what was cancelled


def _received(page):
    try:
        return page.recv(65536)
    except OSError:
        return b""


def test_address_that_is_taken_is_an_error_that_names_it(server, node, port):
    with pytest.raises(DeviceError, match=f"~port {port}: .*Set another address"):
        Server(PhoneDriveConfig(port=port), node, node)


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "0", "0x0", "::0"])
def test_address_that_is_all_of_this_computer_s_is_refused_however_it_is_written(node, port, address):
    with pytest.raises(ConfigError, match=r"^address is '"):
        Server(PhoneDriveConfig(port=port, address=address), node, node)


@pytest.mark.parametrize("address", ["a..b", "x" * 70, "300.1.1.1"])
def test_address_that_is_none_is_an_error_that_names_it(node, port, address):
    with pytest.raises(DeviceError, match=f"~address {address}, "):
        Server(PhoneDriveConfig(port=port, address=address), node, node)
