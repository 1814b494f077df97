"""A peer that is silent, slow or announces too much holds up nobody: handshakes and messages of rospy, over sockets."""
import contextlib
import errno
import socket
import struct
import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

import rospy
from rosgraph.network import encode_ros_handshake_header
from rospy.impl import tcpros_base, tcpros_pubsub, tcpros_service
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse

from car_interface.ros import tcpros_limits
from car_interface.ros.tcpros_limits import (
    HANDSHAKE_S,
    MAX_HANDSHAKES,
    MAX_HEADER_SIZE,
    MAX_MESSAGE_SIZE,
    MIN_HANDSHAKE_S,
    HandshakeError,
    HandshakeTimeout,
    MessageTooLong,
    limit_connections,
    read_header,
)

PATIENCE_S = 20.0
FOUR_GIB = struct.pack("<I", 0xffffffff)
SUBSCRIBER = {"topic": "/steering", "md5sum": String._md5sum, "type": String._type, "callerid": "/board"}
PUBLISHER = {"type": String._type, "md5sum": String._md5sum, "callerid": "/turn_arb"}


ORIGINALS = [(owner, name, vars(owner).get(name)) for owner, name, _ in tcpros_limits._replacements()]


def restore_rospy():
    for owner, name, value in ORIGINALS:
        if value is not None:
            setattr(owner, name, value)
        elif name in vars(owner):
            delattr(owner, name)  # it was its base's


@pytest.fixture(autouse=True)
def limits(monkeypatch):
    """The limits for the length of a test, and a log that holds nothing back."""
    monkeypatch.setattr(tcpros_base, "_use_tcp_keepalive", True)  # else rospy asks the master
    monkeypatch.setattr(tcpros_limits, "_warnings", tcpros_limits._ThreadSafeWarnings())
    monkeypatch.setattr(tcpros_limits, "_handshakes", tcpros_limits._Handshakes())
    assert limit_connections() == ""
    yield
    restore_rospy()


class Server:
    """A TCPROS server of rospy that only notes which connections it was given."""

    def __init__(self):
        self.taken, self.peers = [], []
        self.server = tcpros_base.TCPROSServer()
        self.server.topic_connection_handler = self.server.service_connection_handler = self.take
        self.server.start_server()
        self.address = "127.0.0.1", self.server.tcp_ros_server.port

    def take(self, connection, address, header):
        self.taken.append((connection, header))

    def connect(self, data=b""):
        peer = socket.create_connection(self.address, PATIENCE_S)
        self.peers.append(peer)
        peer.sendall(data)
        return peer

    def names(self):
        return [header["callerid"] for _, header in self.taken]

    def close(self):
        self.server.shutdown()
        for connection in [*self.peers, *(connection for connection, _ in self.taken)]:
            connection.close()
        wait_until(lambda: not tcpros_limits._handshakes._waiting)


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    made = Server()
    yield made
    made.close()


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as made:
        made.settimeout(PATIENCE_S)
        yield made


def header_of(caller="/board", **fields):
    return encode_ros_handshake_header({**SUBSCRIBER, "callerid": caller, **fields})


def wait_until(is_true):
    until = time.monotonic() + PATIENCE_S
    while not is_true():
        assert time.monotonic() < until
        time.sleep(0.002)


def is_closed(peer):
    """Whether the other side has ended a connection."""
    peer.setblocking(False)
    try:
        return peer.recv(1) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


def log_lines(caplog):
    """What the terminal shows. No traceback is in the log file either."""
    assert not any("Traceback" in record.getMessage() for record in caplog.records)
    return [record.getMessage() for record in caplog.records if record.name == "rosout"]


def only_line(caplog):
    """What the terminal shows, once it shows something."""
    wait_until(lambda: log_lines(caplog))
    line, = log_lines(caplog)
    return line


# Handshakes of a server.


def test_silent_connections_keep_no_subscriber_from_its_connection(server):
    for _ in range(5):
        server.connect()
    subscriber = server.connect(header_of())
    wait_until(server.names)
    assert not is_closed(subscriber)


def test_header_that_does_not_come_ends_its_connection_and_the_log_names_the_peer_once(server, caplog):
    silent = [server.connect() for _ in range(5)]
    began_s = time.monotonic()
    wait_until(lambda: all(map(is_closed, silent)))
    assert time.monotonic() - began_s >= HANDSHAKE_S - 0.1
    line = only_line(caplog)
    assert "Inbound TCP/IP connection failed: 127.0.0.1:" in line and "sent no whole header within 1 s" in line
    assert not server.taken


def test_limit_is_for_the_whole_header_not_for_each_byte(server):
    dripping = server.connect()
    header = header_of()
    with pytest.raises(OSError):  # the server closed it before its end, which would take 20 s
        for byte in header:
            dripping.sendall(bytes([byte]))
            time.sleep(20.0 / len(header))
    assert not server.taken


def test_header_in_pieces_is_taken_and_the_connection_blocks_without_a_limit(server):
    peer = server.connect()
    for byte in header_of():
        peer.sendall(bytes([byte]))
    wait_until(server.names)
    (connection, header), = server.taken
    assert connection.gettimeout() is None and header == SUBSCRIBER


def test_what_follows_a_header_stays_for_who_takes_the_connection(server):
    server.connect(header_of() + b"the request")
    wait_until(server.names)
    assert server.taken[0][0].recv(100) == b"the request"


def test_services_take_the_same_way(server):
    for _ in range(5):
        server.connect()
    server.connect(encode_ros_handshake_header({"service": "/save", "md5sum": "*", "callerid": "/tool"}))
    wait_until(server.names)
    assert server.taken[0][1]["service"] == "/save"


def test_of_more_than_the_maximum_the_oldest_are_dropped(server, caplog, monkeypatch):
    monkeypatch.setattr(tcpros_limits, "HANDSHAKE_S", PATIENCE_S)
    silent = [server.connect() for _ in range(MAX_HANDSHAKES + 10)]
    wait_until(lambda: all(map(is_closed, silent[:10])))
    wait_until(lambda: len(tcpros_limits._handshakes._waiting) == MAX_HANDSHAKES)
    assert not any(map(is_closed, silent[10:]))
    assert "was dropped, since 64 newer ones wait for a header, too" in only_line(caplog)


def test_flood_of_connections_does_not_drop_a_subscriber_whose_header_comes_promptly(server):
    flooding = threading.Event()

    def flood():
        while not flooding.is_set():
            with contextlib.ExitStack() as peers:
                for _ in range(50):
                    peers.enter_context(socket.create_connection(server.address, PATIENCE_S))
    threads = [threading.Thread(target=flood) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        for number in range(20):
            subscriber = server.connect()
            time.sleep(MIN_HANDSHAKE_S / 10)
            subscriber.sendall(header_of(f"/board_{number}"))
            wait_until(lambda: server.names()[-1:] == [f"/board_{number}"])
    finally:
        flooding.set()
        for thread in threads:
            thread.join()


def test_none_is_dropped_before_it_had_a_chance(server, monkeypatch):
    dropped_after_s, began_s = [], {}
    shut_down = tcpros_limits._shut_down

    def note_and_shut_down(connection):
        dropped_after_s.append(time.monotonic() - began_s[connection.getpeername()])
        shut_down(connection)
    monkeypatch.setattr(tcpros_limits, "_shut_down", note_and_shut_down)
    for _ in range(3 * MAX_HANDSHAKES):
        peer = socket.socket()
        peer.bind(("127.0.0.1", 0))
        began_s[peer.getsockname()] = time.monotonic()
        peer.connect(server.address)
        server.peers.append(peer)
    wait_until(lambda: len(dropped_after_s) >= MAX_HANDSHAKES)
    assert min(dropped_after_s) >= MIN_HANDSHAKE_S


def test_older_connection_whose_header_comes_later_does_not_replace_the_newer_one(server):
    older = server.connect()
    wait_until(lambda: tcpros_limits._handshakes._waiting)
    server.connect(header_of(md5sum="newer"))
    wait_until(server.names)
    older.sendall(header_of(md5sum="older"))
    wait_until(lambda: is_closed(older))
    assert [header["md5sum"] for _, header in server.taken] == ["newer"]


def test_newer_connection_of_the_same_subscriber_is_handed_on_as_rospy_expects(server):
    for count in (1, 2, 3):
        server.connect(header_of())
        wait_until(lambda: len(server.taken) == count)


def test_header_of_4_gib_ends_its_connection_at_once_with_one_line(server, caplog):
    peer = server.connect(FOUR_GIB + b"topic")
    wait_until(lambda: is_closed(peer))
    line = only_line(caplog)
    assert f"announces a header of 4294967295 bytes, more than {MAX_HEADER_SIZE}" in line
    assert "127.0.0.1:" in line and "\n" not in line


@pytest.mark.parametrize("data", [
    b"\x10\0\0\0" + b"\xff" * 16, b"\x04\0\0\0\0\0\0\0", b"\x02\0\0\0ab", b"\x08\0\0\0\x04\0\0\0abcd",
    b"\x08\0\0\0\x04\0\0\0\xff=\xff\xff", b"GET / HTTP/1.1\r\nHost: car\r\n\r\n"],
    ids=["length of a field", "empty field", "half a length", "no equals sign", "not UTF-8", "a browser"])
def test_what_is_no_header_ends_its_connection_with_one_line(server, caplog, data):
    peer = server.connect(data)
    wait_until(lambda: is_closed(peer))
    line = only_line(caplog)
    assert "Inbound TCP/IP connection failed: 127.0.0.1:" in line and "\n" not in line


def test_header_without_topic_and_service_is_answered_with_an_error(server, caplog):
    peer = server.connect(encode_ros_handshake_header({"callerid": "/tool\n"}))
    assert read_header(peer) == {"error": "no topic or service name detected"}
    wait_until(lambda: is_closed(peer))
    line = only_line(caplog)
    assert line.startswith("Could not process inbound connection of /tool at 127.0.0.1:")


def test_refusal_of_rospy_reaches_the_subscriber_and_the_log(server, caplog):
    server.server.topic_connection_handler = lambda *_: "this topic has another type"
    peer = server.connect(header_of())
    assert read_header(peer) == {"error": "this topic has another type"}
    assert "Could not process inbound connection of /board" in only_line(caplog)
    wait_until(lambda: is_closed(peer))


def test_error_of_a_handler_ends_its_connection_only(server):
    def fail(*_):
        server.server.topic_connection_handler = server.take
        raise ValueError("a fault")
    server.server.topic_connection_handler = fail
    peer = server.connect(header_of())
    wait_until(lambda: is_closed(peer))
    server.connect(header_of())
    wait_until(server.names)


def test_error_of_accepting_is_survived(server, monkeypatch, caplog):
    tcp = server.server.tcp_ros_server
    listening = tcp.server_sock
    errors = [OSError(errno.EMFILE, "Too many open files")]

    def accept():
        if errors:
            raise errors.pop()
        return listening.accept()
    tcp.server_sock = SimpleNamespace(accept=accept, fileno=listening.fileno, close=listening.close)
    server.connect(header_of("/first"))  # the accept that waits already takes this
    server.connect(header_of("/second"))
    wait_until(lambda: server.names() == ["/first", "/second"])
    assert "Too many open files" in log_lines(caplog)[0]


def test_thread_that_cannot_start_costs_its_connection_only(server, monkeypatch):
    start = threading.Thread.start

    def fail(thread):
        monkeypatch.setattr(threading.Thread, "start", start)
        raise RuntimeError("can't start new thread")
    monkeypatch.setattr(threading.Thread, "start", fail)
    peer = server.connect(header_of("/first"))
    wait_until(lambda: is_closed(peer))
    server.connect(header_of("/second"))
    wait_until(lambda: server.names() == ["/second"])


def test_server_that_is_shut_down_ends_its_loop(server):
    tcp = server.server.tcp_ros_server
    tcp.shutdown()
    thread = threading.Thread(target=tcp.run)
    tcp.is_shutdown = False  # as its loop sets it at its start
    thread.start()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()


# What a subscriber waits for.


class Subscription:
    """A connection of rospy to a publisher that the test plays, in rospy's own loop."""

    def __init__(self, listener):
        self.messages = []
        protocol = tcpros_pubsub.TCPROSSub("/steering", String, tcp_nodelay=True)
        self.transport = tcpros_base.TCPROSTransport(protocol, "/steering")
        self.thread = threading.Thread(target=tcpros_pubsub.robust_connect_subscriber, args=(
            self.transport, "127.0.0.1", listener.getsockname()[1], "http://127.0.0.1:1", self.receive, "/steering"))
        self.thread.start()

    def receive(self, messages, _):
        self.messages += [message.data for message in messages]

    def close(self):
        self.transport.close()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


@pytest.fixture
def subscription(listener):
    tcpros_pubsub.check_if_still_publisher = lambda *_: True  # until ``limits`` restores it
    made = Subscription(listener)
    yield made
    made.close()


def accept(listener):
    publisher, _ = listener.accept()
    publisher.settimeout(PATIENCE_S)
    assert read_header(publisher)["topic"] == "/steering"
    return publisher


def string(text):
    return struct.pack("<II", len(text) + 4, len(text)) + text.encode()


def serve_one(listener):
    publisher = accept(listener)
    publisher.sendall(encode_ros_handshake_header(PUBLISHER) + string("left"))
    return publisher


@pytest.mark.parametrize("first", [b"", FOUR_GIB, b"\x02\0\0\0ab"], ids=["silent", "4 GiB", "no header"])
def test_publisher_without_a_header_is_tried_again(listener, subscription, caplog, first):
    silent = accept(listener)
    silent.sendall(first)
    publisher = serve_one(listener)
    wait_until(lambda: subscription.messages == ["left"])
    assert is_closed(silent) or silent.recv(1) == b""
    line = only_line(caplog)
    assert line.startswith("/steering: 127.0.0.1:") and line.endswith("; trying again")
    assert subscription.transport.socket.gettimeout() is None
    publisher.close()


def test_publisher_that_leaves_in_the_handshake_is_tried_again(listener, subscription):
    accept(listener).close()
    publisher = serve_one(listener)
    wait_until(lambda: subscription.messages == ["left"])
    publisher.close()


def test_publisher_that_drips_its_header_is_given_up(listener, subscription):
    dripping = accept(listener)
    header = encode_ros_handshake_header(PUBLISHER)
    with pytest.raises(OSError):
        for byte in header:
            dripping.sendall(bytes([byte]))
            time.sleep(20.0 / len(header))


def test_subscription_that_ends_while_it_waits_for_a_header_ends_its_thread(listener, subscription):
    accept(listener)
    subscription.close()


@pytest.mark.parametrize("before", ["", "right"], ids=["first message", "behind another one"])
def test_message_of_4_gib_closes_the_connection_with_one_line_and_rospy_connects_again(listener, subscription, caplog,
                                                                                      before):
    publisher = accept(listener)
    publisher.sendall(encode_ros_handshake_header(PUBLISHER) + (string(before) if before else b""))
    publisher.sendall(FOUR_GIB + b"x" * 9)
    again = serve_one(listener)
    wait_until(lambda: subscription.messages == ([before] if before else []) + ["left"])
    wait_until(lambda: is_closed(publisher))
    line = only_line(caplog)
    assert line.startswith("/steering: 127.0.0.1:") and "announces a message of 4294967295 bytes" in line
    again.close()


def test_after_a_message_that_rospy_cannot_read_nothing_of_it_is_taken_for_the_next_header(listener, subscription):
    publisher = accept(listener)
    publisher.sendall(encode_ros_handshake_header(PUBLISHER) + b"\2\0\0\0ab")
    again = serve_one(listener)
    wait_until(lambda: subscription.messages == ["left"])
    publisher.close()
    again.close()


def test_message_of_the_longest_length_arrives(listener, subscription):
    publisher = accept(listener)
    publisher.sendall(encode_ros_handshake_header(PUBLISHER) + string("x" * (MAX_MESSAGE_SIZE - 4)))
    wait_until(lambda: [len(text) for text in subscription.messages] == [MAX_MESSAGE_SIZE - 4])
    publisher.close()


def test_longer_message_does_not(listener, subscription):
    publisher = accept(listener)
    publisher.sendall(encode_ros_handshake_header(PUBLISHER) + string("x" * (MAX_MESSAGE_SIZE - 3))[:100_000])
    again = serve_one(listener)
    wait_until(lambda: subscription.messages == ["left"])
    again.close()


def test_publisher_that_does_not_say_whether_it_still_is_one_counts_as_one(listener):
    uri = f"http://127.0.0.1:{listener.getsockname()[1]}"
    assert tcpros_limits._is_still_publisher("/steering", uri)  # the kernel accepts, and nobody answers


def test_publisher_that_has_ended_is_none():
    with socket.create_server(("127.0.0.1", 0)) as ended:
        uri = f"http://127.0.0.1:{ended.getsockname()[1]}"
    assert not tcpros_limits._is_still_publisher("/steering", uri)


# Services.


class ServiceServer:
    """A service of rospy without a master."""

    def __init__(self, server):
        implementation = object.__new__(tcpros_service.ServiceImpl)
        implementation.resolved_name, implementation.seq = "/save", 0
        implementation.response_class = SetBoolResponse
        implementation.handler = lambda request: SetBoolResponse(request.data, "done")
        self.protocol = tcpros_service.TCPService("/save", SetBool)
        server.server.service_connection_handler = self.take
        self.implementation = implementation

    def take(self, connection, _, header):
        transport = tcpros_base.TCPROSTransport(self.protocol, "/save", header)
        transport.set_socket(connection, header["callerid"])
        transport.write_header()
        threading.Thread(target=self.implementation.handle, args=(transport, header), daemon=True).start()


def client_of(address):
    protocol = tcpros_service.TCPROSServiceClient("/save", SetBool, headers={"persistent": "1"})
    transport = tcpros_base.TCPROSTransport(protocol, "/save")
    transport.connect(*address, "rosrpc://127.0.0.1")
    return transport


def test_service_answers(server):
    ServiceServer(server)
    client = client_of(server.address)
    for number in (1, 2):
        client.send_message(SetBool._request_class(True), number)
        response, = client.receive_once()
        assert response.success and response.message == "done"
    client.close()


@pytest.mark.parametrize("header", [{"persistent": "1"}, {}], ids=["persistent", "once"])
def test_request_of_4_gib_closes_the_connection_with_one_line(server, caplog, header):
    ServiceServer(server)
    peer = server.connect(encode_ros_handshake_header(
        {"service": "/save", "md5sum": SetBool._md5sum, "callerid": "/tool", **header}))
    read_header(peer)
    peer.sendall(FOUR_GIB + b"x")
    wait_until(lambda: is_closed(peer))
    line = only_line(caplog)
    assert line.startswith("/save: /tool: 127.0.0.1:") and "announces a message of 4294967295 bytes" in line


@pytest.mark.parametrize("ok", [b"\1", b"\0"], ids=["response", "error"])
@pytest.mark.parametrize("pieces", [1, 5], ids=["at once", "byte by byte"])
def test_answer_of_4_gib_fails_the_call(listener, ok, pieces):
    def answer():
        connection, _ = listener.accept()
        read_header(connection)
        connection.sendall(encode_ros_handshake_header({"type": SetBool._type, "md5sum": SetBool._md5sum}))
        data = ok + FOUR_GIB
        for index in range(pieces):
            connection.sendall(data[index * 5 // pieces:(index + 1) * 5 // pieces])
            time.sleep(0.02)
        connections.append(connection)
    connections = []
    thread = threading.Thread(target=answer)
    thread.start()
    client = client_of(listener.getsockname())
    with pytest.raises(MessageTooLong, match=r"127\.0\.0\.1:.* announces a message of 4294967295 bytes"):
        client.receive_once()
    thread.join()
    wait_until(lambda: is_closed(connections[0]))
    assert isinstance(MessageTooLong(), rospy.ServiceException)  # what a caller expects


# read_header by itself.


def test_silent_peer_is_a_timeout_and_one_that_left_is_not(listener):
    peer = socket.create_connection(listener.getsockname())
    connection, _ = listener.accept()
    with pytest.raises(HandshakeTimeout, match="sent no whole header within 1 s"):
        read_header(connection)
    peer.close()
    with pytest.raises(HandshakeError, match="closed the connection before its header was whole"):
        read_header(connection)
    connection.close()


# Another rospy.


def test_limits_are_set_once():
    before = [vars(owner)[name] for owner, name, _ in ORIGINALS]
    assert limit_connections() == ""
    assert [vars(owner)[name] for owner, name, _ in ORIGINALS] == before


@pytest.mark.parametrize("owner, name, value, reason", [
    (tcpros_base.TCPServer, "run", None, "there is no TCPServer.run"),
    (tcpros_pubsub, "robust_connect_subscriber", None, "there is no robust_connect_subscriber"),
    (tcpros_base, "TCPROSServer", None, "there is no TCPROSServer.__init__"),
    (tcpros_base.TCPROSTransport, "read_header", lambda self, timeout: None,
     "TCPROSTransport.read_header has other parameters"),
    (tcpros_base.TCPROSTransport, "read_header", lambda self: None,
     "TCPROSTransport.read_header doesn't use _validate_header"),
    (tcpros_pubsub.TCPROSSub, "read_messages", lambda *_: None, "TCPROSSub has a read_messages of its own"),
], ids=["method missing", "function missing", "class missing", "other parameters", "other body", "overridden"])
def test_rospy_that_is_not_known_is_left_alone_with_a_line_for_the_log(owner, name, value, reason):
    restore_rospy()
    with pytest.MonkeyPatch.context() as patch:
        if value is None:
            patch.delattr(owner, name)
        else:
            patch.setattr(owner, name, value, raising=False)
        before = [vars(owner).get(name) for owner, name, _ in ORIGINALS]
        assert f"({reason})" in limit_connections()
        assert [vars(owner).get(name) for owner, name, _ in ORIGINALS] == before
