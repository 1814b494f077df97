"""A peer that is silent, slow or announces too much holds up nobody: handshakes and messages of rospy, over sockets."""
import errno
import os
import socket
import struct
import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

import rospy
from rosgraph.network import encode_ros_handshake_header
from rospy import topics
from rospy.impl import tcpros_base, tcpros_pubsub, tcpros_service
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse

from car_interface.ros import tcpros_limits
from car_interface.ros.tcpros_limits import MessageTooLong, limit_connections, read_header
from car_interface.ros.topics import DirectConnection
from loopback import PATIENCE_S, eventually

MAX_MESSAGE_SIZE = 300_000  # in here
FOUR_GIB = struct.pack("<I", 0xffffffff)
SUBSCRIBER = {"topic": "/steering", "md5sum": String._md5sum, "type": String._type, "callerid": "/board"}
PUBLISHER = encode_ros_handshake_header({"type": String._type, "md5sum": String._md5sum, "callerid": "/turn_arb"})
ORIGINALS = [(owner, name, vars(owner).get(name)) for owner, name, _ in tcpros_limits._replacements()]


def restore_rospy():
    for owner, name, value in ORIGINALS:
        if value is not None:
            setattr(owner, name, value)
        elif name in vars(owner):
            delattr(owner, name)  # it was its base's


def functions_of_rospy():
    return [vars(owner).get(name) for owner, name, _ in ORIGINALS]


@pytest.fixture(autouse=True)
def limits(monkeypatch):
    """The limits for the length of a test, and a log that holds nothing back."""
    monkeypatch.setattr(tcpros_limits, "MAX_MESSAGE_SIZE", MAX_MESSAGE_SIZE)
    monkeypatch.setattr(tcpros_base, "_use_tcp_keepalive", True)  # else rospy asks the master
    monkeypatch.setattr(tcpros_limits, "_warnings", tcpros_limits.ThrottledWarnings(tcpros_limits.SYSTEM))
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


def is_closed(peer):
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
    eventually(lambda: log_lines(caplog))
    line, = log_lines(caplog)
    assert "\n" not in line
    return line


def test_header_that_is_there_counts_though_this_process_stood_still_beyond_the_deadline(monkeypatch, listener):
    monkeypatch.setattr(tcpros_limits, "HANDSHAKE_S", -3.0)
    with socket.create_connection(listener.getsockname()) as peer, listener.accept()[0] as ours:
        peer.sendall(header_of())
        assert read_header(ours)["callerid"] == "/board"
        with pytest.raises(tcpros_limits.HandshakeTimeout):
            read_header(ours)


def test_silent_and_slow_peers_hold_up_nobody_and_are_dropped_after_a_second_with_one_line(server, caplog):
    began_s = time.monotonic()
    waiting = [server.connect() for _ in range(5)]
    slow = server.connect()
    server.connect(encode_ros_handshake_header({"service": "/save", "md5sum": "*", "callerid": "/tool"}))
    subscriber = server.connect(header_of())
    eventually(lambda: sorted(server.names()) == ["/board", "/tool"])
    with pytest.raises(OSError):  # the server closes it before its end, which would take 20 s
        for byte in header_of("/slow"):
            slow.sendall(bytes([byte]))
            time.sleep(0.1)
    assert time.monotonic() - began_s > tcpros_limits.HANDSHAKE_S - 0.1
    eventually(lambda: all(map(is_closed, waiting)))
    line = only_line(caplog)
    assert "Inbound TCP/IP connection failed: 127.0.0.1:" in line and "sent no whole header within 1 s" in line
    assert len(server.taken) == 2 and not is_closed(subscriber)


def test_of_too_many_that_wait_the_oldest_is_dropped_and_headers_are_taken_in_the_order_of_connecting(
        server, caplog, monkeypatch):
    monkeypatch.setattr(tcpros_limits, "MAX_HANDSHAKES", 3)
    waiting = [server.connect() for _ in range(3)]
    for name in ("/first", "/second", "/third"):
        server.connect(header_of(name))
    eventually(lambda: server.names() == ["/first", "/second", "/third"])
    assert any("was dropped, since 3 newer ones wait" in line for line in log_lines(caplog))
    assert is_closed(waiting[0])


def test_header_in_pieces_is_taken_and_what_follows_it_is_left_on_a_connection_without_a_limit(server):
    peer = server.connect()
    for byte in header_of() + b"the request":
        peer.sendall(bytes([byte]))
    eventually(server.names)
    (connection, header), = server.taken
    assert connection.gettimeout() is None and header == SUBSCRIBER
    assert connection.recv(11, socket.MSG_WAITALL) == b"the request"


@pytest.mark.parametrize("data, text", [
    (FOUR_GIB + b"topic", f"announces a header of 4294967295 bytes, more than {tcpros_limits.MAX_HEADER_SIZE}"),
    (b"\x08\0\0\0\x04\0\0\0\xff=\xff\xff", "sends no TCPROS header")], ids=["4 GiB", "not UTF-8"])
def test_what_is_no_header_ends_its_connection_with_one_line(server, caplog, data, text):
    peer = server.connect(data)
    eventually(lambda: is_closed(peer))
    line = only_line(caplog)
    assert line.startswith("Inbound TCP/IP connection failed: 127.0.0.1:") and text in line


@pytest.mark.parametrize("header, error", [
    (encode_ros_handshake_header({"callerid": "/tool\n"}), "no topic or service name detected"),
    (header_of("/tool"), "this topic has another type"),
], ids=["neither topic nor service", "refused by rospy"])
def test_refusal_reaches_the_peer_and_the_log(server, caplog, header, error):
    server.server.topic_connection_handler = lambda *_: "this topic has another type"
    peer = server.connect(header)
    assert read_header(peer) == {"error": error}
    eventually(lambda: is_closed(peer))
    line = only_line(caplog)
    assert line.startswith("Could not process inbound connection of /tool at 127.0.0.1:") and error in line


def test_a_peer_that_does_not_read_a_long_refusal_holds_up_nobody(server):
    server.server.topic_connection_handler = lambda *_: "x" * 20_000_000  # more than the buffers of a connection
    deaf = server.connect(header_of())
    server.connect(encode_ros_handshake_header({"service": "/save", "md5sum": "*", "callerid": "/tool"}))
    eventually(server.names)
    assert read_header(deaf) == {"error": "x" * tcpros_limits.MAX_REFUSAL}


def test_error_of_a_handler_or_of_accepting_costs_one_connection_at_most(server, caplog):
    tcp = server.server.tcp_ros_server
    listening, errors = tcp.server_sock, [OSError(errno.EMFILE, "Too many open files")]

    def accept():
        if errors:
            raise errors.pop()
        return listening.accept()

    def fail(*_):
        server.server.topic_connection_handler = server.take
        raise ValueError("a fault")
    server.server.topic_connection_handler = fail
    tcp.server_sock = SimpleNamespace(accept=accept, fileno=listening.fileno, close=listening.close,
                                      listen=listening.listen, setblocking=listening.setblocking)
    first = server.connect(header_of("/first"))
    eventually(lambda: is_closed(first))
    server.connect(header_of("/second"))
    eventually(lambda: server.names() == ["/second"])
    assert any("Too many open files" in record.getMessage() for record in caplog.records)


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


def accept(listener, data=b""):
    """A connection to a publisher that sends this."""
    publisher, _ = listener.accept()
    publisher.settimeout(PATIENCE_S)
    assert read_header(publisher)["topic"] == "/steering"
    publisher.sendall(data)
    return publisher


def string(text):
    return struct.pack("<II", len(text) + 4, len(text)) + text.encode()


@pytest.mark.parametrize("first, text", [
    (b"", "sent no whole header within 1 s"), (FOUR_GIB, "announces a header"),
    (None, "closed the connection before its header was whole")], ids=["silent", "4 GiB", "leaves"])
def test_publisher_without_a_header_is_tried_again_after_one_line(listener, subscription, caplog, first, text):
    publisher = accept(listener, first or b"")
    if first is None:
        publisher.close()
    with accept(listener, PUBLISHER + string("left")):
        eventually(lambda: subscription.messages == ["left"])
        assert subscription.transport.socket.gettimeout() is None
    assert first is None or is_closed(publisher)
    line = log_lines(caplog)[0]
    assert line.startswith("/steering: 127.0.0.1:") and line.endswith("; trying again") and text in line


@pytest.mark.parametrize("data, before, length", [
    (string("right") + FOUR_GIB + b"x" * 9, ["right"], 0xffffffff),
    (string("x" * (MAX_MESSAGE_SIZE - 3))[:100_000], [], MAX_MESSAGE_SIZE + 1), (b"\2\0\0\0ab", [], None),
], ids=["behind another one", "a byte too long", "rospy cannot read it"])
def test_after_a_message_that_is_too_long_or_none_rospy_connects_again(listener, subscription, caplog, data, before,
                                                                     length):
    publisher = accept(listener, PUBLISHER + data)
    with accept(listener, PUBLISHER + string("left")):  # of the first connection nothing is taken for this header
        eventually(lambda: subscription.messages == [*before, "left"])
        eventually(lambda: is_closed(publisher))
    if length:
        line = log_lines(caplog)[0]
        assert line.startswith("/steering: 127.0.0.1:") and f"announces a message of {length} bytes" in line


def test_message_of_the_longest_length_arrives(listener, subscription):
    with accept(listener, PUBLISHER + string("x" * (MAX_MESSAGE_SIZE - 4))):
        eventually(lambda: [len(text) for text in subscription.messages] == [MAX_MESSAGE_SIZE - 4])


def test_publisher_that_does_not_answer_still_counts_as_one_and_one_that_has_ended_does_not(listener):
    uri = f"http://127.0.0.1:{listener.getsockname()[1]}"
    assert tcpros_limits._is_still_publisher("/steering", uri)  # the kernel accepts, and nobody answers
    listener.close()
    assert not tcpros_limits._is_still_publisher("/steering", uri)


@pytest.fixture
def service(server):
    implementation = object.__new__(tcpros_service.ServiceImpl)
    implementation.resolved_name, implementation.seq = "/save", 0
    implementation.response_class = SetBoolResponse
    implementation.handler = lambda request: SetBoolResponse(request.data, "done")

    def take(connection, _, header):
        transport = tcpros_base.TCPROSTransport(tcpros_service.TCPService("/save", SetBool), "/save", header)
        transport.set_socket(connection, header["callerid"])
        transport.write_header()
        threading.Thread(target=implementation.handle, args=(transport, header), daemon=True).start()
    server.server.service_connection_handler = take
    return server


def client_of(address, is_persistent=True):
    headers = {"persistent": "1"} if is_persistent else {}
    protocol = tcpros_service.TCPROSServiceClient("/save", SetBool, headers=headers)
    transport = tcpros_base.TCPROSTransport(protocol, "/save")
    transport.connect(*address, "rosrpc://127.0.0.1")
    return transport


@pytest.mark.parametrize("is_persistent", [True, False])
def test_service_answers_and_a_request_of_4_gib_closes_the_connection_with_one_line(service, caplog, is_persistent):
    peer = client_of(service.address, is_persistent)
    for number in range(is_persistent):
        peer.send_message(SetBool._request_class(True), number)
        response, = peer.receive_once()
        assert response.success and response.message == "done"
    peer.socket.sendall(FOUR_GIB + b"x")
    eventually(lambda: is_closed(peer.socket))
    line = only_line(caplog)
    assert line.startswith("/save: ") and ": 127.0.0.1:" in line
    assert "announces a message of 4294967295 bytes" in line
    peer.close()


@pytest.mark.parametrize("ok, size", [(b"\1", 5), (b"\0", 1)], ids=["response", "error byte by byte"])
def test_answer_of_4_gib_fails_the_call(listener, ok, size):
    connections = []

    def answer():
        connection, _ = listener.accept()
        connections.append(connection)
        read_header(connection)
        connection.sendall(encode_ros_handshake_header({"type": SetBool._type, "md5sum": SetBool._md5sum}))
        data = ok + FOUR_GIB
        for start in range(0, 5, size):
            connection.sendall(data[start:start + size])
            time.sleep(0.02)
    thread = threading.Thread(target=answer)
    thread.start()
    client = client_of(listener.getsockname())
    with pytest.raises(MessageTooLong, match=r"127\.0\.0\.1:.* announces a message of 4294967295 bytes"):
        client.receive_once()
    thread.join()
    eventually(lambda: is_closed(connections[0]))
    assert isinstance(MessageTooLong(), rospy.ServiceException)  # what a caller expects


@pytest.fixture
def publication():
    """rospy's list of a topic's subscribers, and a function that makes a connection to one and its other end."""
    topic, open_sockets = topics._TopicImpl("/steering", String), []

    def connection():
        here, there = socket.socketpair()
        open_sockets.extend((here, there))
        made = tcpros_base.TCPROSTransport(tcpros_pubsub.TCPROSPub("/steering", String), "/steering")
        made.set_socket(here, "/board")
        return made, there
    yield topic, connection
    topic.close()
    for each in open_sockets:
        each.close()


@pytest.mark.parametrize("queue", [tcpros_pubsub.QueuedConnection, DirectConnection])
def test_connection_that_ends_late_takes_not_its_successor_with_the_same_descriptor_with_it(publication, queue):
    topic, connect = publication
    (replaced, _), (first, _) = connect(), connect()
    for each in (replaced, first):
        topic.add_connection(queue(each, 10))
    assert [each.fileno() for each in topic.connections] == [first.fileno()] and replaced.done
    (second, subscriber), clean_up = connect(), first.cleanup_cb

    def be_replaced_first(gone):
        second._fileno = os.dup2(second.fileno(), gone.fileno())  # the kernel gives the number again: it is free now
        topic.add_connection(queue(second, 10))
        clean_up(gone)
    first.cleanup_cb = be_replaced_first
    first.close()
    assert len(topic.connections) == 1 and not second.done and first.done
    subscriber.close()
    topic.check()
    assert second.done and not topic.connections
    os.close(second.fileno())


def test_end_of_a_connection_that_a_child_process_still_holds_is_not_that_of_another_with_its_descriptor(publication):
    topic, connect = publication
    (first, _), (second, subscriber) = connect(), connect()
    topic.add_connection(first)
    held = os.dup(first.fileno())  # as by a fork, until the child is another program
    first.close()
    second._fileno = os.dup2(second.fileno(), first.fileno())
    topic.add_connection(second)
    topic.check()
    assert topic.connections == [second] and not second.done
    subscriber.close()
    topic.check()
    assert second.done and not topic.connections
    for each in (held, second.fileno()):
        os.close(each)


def test_no_connection_is_added_while_rospy_looks_for_broken_ones(publication):
    topic, connect = publication
    topic.add_connection(connect()[0])
    looked = []

    def look():
        looked.append(topic.c_lock.acquire(blocking=False))
        if looked[0]:
            topic.c_lock.release()

    def broken():
        adding = threading.Thread(target=look)
        adding.start()
        adding.join()
        yield topic.connections[0].fileno()
    topic.connection_poll.error_iter = broken
    topic.check()
    assert looked == [False] and not topic.connections


@pytest.mark.parametrize("owner, name, value, reason", [
    (tcpros_base.TCPServer, "run", None, "type object 'TCPServer' has no attribute 'run'"),
    (tcpros_service.ServiceImpl, "handle", lambda self, transport: None, "ServiceImpl.handle takes self, transport"),
], ids=["missing", "other parameters"])
def test_rospy_that_is_not_known_is_left_alone_with_a_line_for_the_log(owner, name, value, reason):
    restore_rospy()
    with pytest.MonkeyPatch.context() as patch:
        if value is None:
            patch.delattr(owner, name)
        else:
            patch.setattr(owner, name, value, raising=False)
        before = functions_of_rospy()
        assert f"({reason})" in limit_connections()
        assert functions_of_rospy() == before
