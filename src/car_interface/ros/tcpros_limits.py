"""Keeps a peer that is silent, or announces too much, from holding up this process's TCPROS connections.

rospy reads the header of a new connection in the thread that accepts connections, and waits for it without a time
limit: after one silent peer nobody else is connected. It waits as long for the header of a publisher, and buffers a
message of any length that a peer announces. Here

- the thread of a server reads the headers of all its new connections as they arrive, each of which has ``HANDSHAKE_S``
  for its whole header; of more than ``MAX_HANDSHAKES`` the oldest is dropped,
- a publisher or a service has as long for the header with which it answers; the subscriber then tries again, with
  rospy's back-off,
- a message or a header that is announced as longer than ``MAX_MESSAGE_SIZE`` or ``MAX_HEADER_SIZE`` closes the
  connection,
- a connection that ends takes no other one with it. rospy knows a topic's connections by the numbers of their file
  descriptors, which the next connection gets again: a publisher then never sent anything to that one, and neither side
  noticed. It happened where a node that had stood still replaced its connections.

An established connection blocks as before. See http://wiki.ros.org/ROS/TCPROS for the protocol.
"""
from __future__ import annotations

import inspect
import logging
import select
import socket
import struct
import sys
import traceback
from contextlib import suppress
from typing import Any

import rospy
from rosgraph.network import decode_ros_handshake_header, write_ros_handshake_header
from rospy import topics
from rospy.exceptions import TransportException, TransportInitError
from rospy.impl import tcpros_base, tcpros_pubsub, tcpros_service
from rospy.impl.transport import INBOUND
from rospy.service import ServiceException

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.xmlrpc_calls import call

HANDSHAKE_S = 1.0  # a header arrives within a round trip: 0.2 ms on one computer, 2 to 100 ms over Wi-Fi
MAX_HANDSHAKES = 64
# None is dropped before it has lasted so long, which is a slow round trip: a flood of connections must not end that of
# a real subscriber. Until then new connections wait in the kernel's queue, so that a flood of them is taken at
# MAX_HANDSHAKES / MIN_HANDSHAKE_NS = 640 a second at most, and the whole queue in 1.6 s.
MIN_HANDSHAKE_NS = NS_PER_S // 10
ACCEPT_QUEUE = 1024  # rospy's 5 would overflow, and the kernel tries again a second later
ACCEPT_PAUSE_S = 0.1  # after an error, such as too many open files
MAX_MESSAGE_SIZE = 16_000_000  # bytes; this package's longest message has some 10 kB, a camera's image 6 MB
MAX_HEADER_SIZE = 256_000  # bytes; MAX_HANDSHAKES of them are one message. The longest definitions have some 100 kB
# Characters that tell a peer why it is refused, among them what it sent. A send buffer takes so much at once: a peer
# that doesn't read must not hold up the others.
MAX_REFUSAL = 2000
MAX_REPORT = 300  # characters of an error that a peer may have written
LENGTH = struct.Struct("<I")  # before a header and before a message
OK_SIZE = 1  # of the byte before a service's response
REFUSAL_KINDS = 64
FAILED = "Inbound TCP/IP connection failed"

_log = logging.getLogger("car_interface")


class HandshakeError(TransportInitError):
    """A connection was not made."""


class HandshakeTimeout(HandshakeError):
    """The peer took longer than ``HANDSHAKE_S``."""


class MessageTooLong(TransportException, ServiceException):
    """A peer announced a message that is longer than ``MAX_MESSAGE_SIZE``.

    As a ``ServiceException`` it passes ``receive_once`` unchanged; as a ``TransportException`` it has a subscriber
    connect again.
    """


_warnings = ThrottledWarnings(SYSTEM)


class _Handshake:
    """Reads the header with which a peer begins, and leaves the connection without a time limit."""

    def __init__(self, connection: socket.socket):
        connection.settimeout(None)
        self.connection, self.peer = connection, _address(connection)
        self.began_ns = SYSTEM.now_ns()
        self.due_ns = self.began_ns + round(HANDSHAKE_S * NS_PER_S)
        self._received, self._size = bytearray(), LENGTH.size  # what is to come: at first the length of the header

    def read(self) -> dict[str, str] | None:
        """Read what has come so far, without waiting; return the header once it is whole.

        Raises:
            HandshakeTimeout: it is not whole within ``HANDSHAKE_S``.
            HandshakeError: the peer has gone, or sends no header.
        """
        received = self._received
        try:
            while len(received) < self._size:
                part = self.connection.recv(self._size - len(received), socket.MSG_DONTWAIT)
                if not part:
                    raise HandshakeError(f"{self.peer} closed the connection before its header was whole")
                received += part
                if len(received) == LENGTH.size:
                    size, = LENGTH.unpack(received)
                    if size > MAX_HEADER_SIZE:
                        raise HandshakeError(f"{self.peer} announces a header of {size} bytes, more than "
                                             f"{MAX_HEADER_SIZE}")
                    self._size += size
            return decode_ros_handshake_header(bytes(received))
        except HandshakeError:
            raise
        except BlockingIOError:
            # After the deadline what was there has been read: this process may have stood still meanwhile.
            if SYSTEM.now_ns() >= self.due_ns:
                raise HandshakeTimeout(f"{self.peer} sent no whole header within {HANDSHAKE_S:g} s") from None
            return None
        except OSError as error:
            raise HandshakeError(f"{self.peer} has gone ({error})") from None
        except Exception as error:  # decoding raises several
            raise HandshakeError(f"{self.peer} sends no TCPROS header ({_clip(error)})") from None


def read_header(connection: socket.socket) -> dict[str, str]:
    """Read the header with which a peer begins, and wait for it.

    Raises:
        HandshakeError: see ``_Handshake.read``.
    """
    handshake = _Handshake(connection)
    while True:
        header = handshake.read()
        if header is not None:
            return header
        _wait([connection], handshake.due_ns)


def _wait(connections, due_ns=None):
    """Wait until one of them has something to read, or for the time."""
    poll = select.poll()
    for connection in connections:
        poll.register(connection, select.POLLIN)
    poll.poll(None if due_ns is None else max(0.0, (due_ns - SYSTEM.now_ns()) / NS_PER_MS))


def _write_header(connection, header):
    """Write a header within ``HANDSHAKE_S``; how many bytes that were. Takes the place of rosgraph's."""
    connection.settimeout(HANDSHAKE_S)  # of sendall it limits the whole
    try:
        written = write_ros_handshake_header(connection, header)
    except socket.timeout:
        raise HandshakeTimeout(f"{_address(connection)} takes no header within {HANDSHAKE_S:g} s") from None
    connection.settimeout(None)
    return written


def _read_header_into(connection, buffer, _):
    """Take the place of rosgraph's function: ``buffer`` gets what follows the header, of which nothing was read."""
    _empty(buffer)  # after a message that was refused it holds the beginning of that
    return read_header(connection)


def _serve(self):
    """Take the place of ``TCPServer.run``."""
    with suppress(OSError):  # it was closed already
        self.server_sock.listen(ACCEPT_QUEUE)
        self.server_sock.setblocking(False)
    waiting: list[_Handshake] = []  # for their header, oldest first
    while not self.is_shutdown:
        try:
            _step(self, waiting)
        except (OSError, ValueError) as error:  # a ValueError: it was closed
            if not self.is_shutdown:
                _warnings.warn("accept", f"can't accept connections: {error}")
                SYSTEM.sleep(ACCEPT_PAUSE_S)


def _step(server, waiting):
    """Wait for headers and connections, and take what has come.

    The oldest header is taken first: rospy has one connection of each subscriber, the last one.
    """
    room_ns = waiting[0].began_ns + MIN_HANDSHAKE_NS if len(waiting) >= MAX_HANDSHAKES else 0
    is_full = SYSTEM.now_ns() < room_ns
    due_ns = room_ns if is_full else waiting[0].due_ns if waiting else None
    _wait([*(each.connection for each in waiting), *([] if is_full else [server.server_sock])], due_ns)
    waiting[:] = [each for each in waiting if not _take(server, each)]
    if is_full:
        return
    with suppress(BlockingIOError, ConnectionAbortedError):  # there is none, or it has gone
        connection, _ = server.server_sock.accept()
        waiting.append(_Handshake(connection))
        if len(waiting) > MAX_HANDSHAKES:
            oldest = waiting.pop(0)
            oldest.connection.close()
            _warnings.warn("dropped", f"{FAILED}: {oldest.peer} was dropped, since {MAX_HANDSHAKES} newer ones wait "
                                      "for a header, too")


def _take(server, handshake):
    """Have rospy take a connection if its header is there; return whether that is done, or has failed."""
    try:
        header = handshake.read()
        if header is not None:
            server.inbound_handler(handshake.connection, header)
        return header is not None
    except Exception as error:
        handshake.connection.close()
        if rospy.core.is_shutdown_requested():
            return True
        if not isinstance(error, (HandshakeError, OSError)):
            _log.error("%s", traceback.format_exc())
        who = "" if isinstance(error, HandshakeError) else f"{handshake.peer}: "
        _warnings.warn(type(error).__name__, f"{FAILED}: {who}{_clip(error)}")
        return True


def _hand_on(self, connection, header):
    """Take the place of ``TCPROSServer._tcp_server_callback``, for a connection whose header is there."""
    if "topic" in header:
        refusal = self.topic_connection_handler(connection, connection.getpeername(), header)
    elif "service" in header:
        refusal = self.service_connection_handler(connection, connection.getpeername(), header)
    else:
        refusal = "no topic or service name detected"
    if not refusal:
        return
    is_ending, peer, refusal = rospy.core.is_shutdown_requested(), _address(connection), refusal[:MAX_REFUSAL]
    _write_header(connection, {"error": "node shutting down" if is_ending else refusal})
    connection.close()
    if not is_ending:
        caller = _clip(header.get("callerid", "a peer without a name"))
        # A kind for each caller, of which there may be any number.
        _warnings.warn(f"refused {hash(caller) % REFUSAL_KINDS}",
                       f"Could not process inbound connection of {caller} at {peer}: {_clip(refusal)}")


def _check_length(buffer, offset, connection):
    """Refuse a message of which a part has come.

    Raises:
        MessageTooLong: it is announced as longer than ``MAX_MESSAGE_SIZE``. The connection ends.
    """
    if buffer.tell() < offset + LENGTH.size:
        return
    with buffer.getbuffer() as received:
        size, = LENGTH.unpack_from(received, offset)
    if size > MAX_MESSAGE_SIZE:
        peer = _address(connection)
        _empty(buffer)
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        raise MessageTooLong(f"{peer} announces a message of {size} bytes; more than {MAX_MESSAGE_SIZE} closes the "
                             "connection")


def _limited(read_messages, offset=0):
    """Return a protocol's ``read_messages`` with the limit. Of a message that is whole the length needs no check."""
    def read(self, buffer, messages, connection):
        read_messages(self, buffer, messages, connection)
        try:
            if not messages:
                _check_length(buffer, offset, connection)
        except MessageTooLong as error:
            if self.direction == INBOUND:  # of a subscription; of a service who handles or calls it logs that
                _warnings.warn(f"length {self.resolved_name}", f"{self.resolved_name}: {error}")
            raise
    return read


def _replacements() -> list[tuple[Any, str, Any]]:
    """Return what takes the place of what in rospy: owner, attribute, new value."""
    transport, topic = tcpros_base.TCPROSTransport, tcpros_pubsub.TCPROSSub
    connections = topics._TopicImpl
    service, client = tcpros_service.TCPService, tcpros_service.TCPROSServiceClient
    connect, receive_more = transport.connect, tcpros_service.recv_buff
    handle, log_error = tcpros_service.ServiceImpl.handle, tcpros_base.rospyerr

    def connect_or_be_ready_again(self, *arguments, **keywords):
        try:
            connect(self, *arguments, **keywords)
        except HandshakeError as error:
            # Without a socket, and not closed, rospy's loops try again.
            connection, self.socket = self.socket, None
            if connection is not None:
                connection.close()
            if not self.done and self.direction == INBOUND:
                _warnings.warn(f"connect {self.name}", f"{self.name}: {error}; trying again")
            raise

    def receive_error(connection, buffer, size):
        """Receive a part of the error that a service answers with."""
        _check_length(buffer, OK_SIZE, connection)
        return receive_more(connection, buffer, size)

    def handle_or_close(self, connection, header):
        try:
            handle(self, connection, header)
        except TransportException as error:
            _warnings.warn(f"length {self.resolved_name}",
                           f"{self.resolved_name}: {_clip(connection.endpoint_id)}: {_clip(error)}")
            connection.close()

    def log_other_error(*arguments):
        if not isinstance(sys.exc_info()[1], HandshakeError):  # that is logged in one line
            log_error(*arguments)

    return [(tcpros_base.TCPServer, "run", _serve), (tcpros_base.TCPROSServer, "_tcp_server_callback", _hand_on),
            (tcpros_base, "read_ros_handshake_header", _read_header_into),
            (tcpros_base, "write_ros_handshake_header", _write_header), (tcpros_base, "rospyerr", log_other_error),
            (transport, "connect", connect_or_be_ready_again),
            (tcpros_pubsub, "check_if_still_publisher", _is_still_publisher),
            (connections, "_remove_connection", _remove_connection), (connections, "check", _locked(connections.check)),
            (topics.Poller, "error_epoll_iter", _confirmed(topics.Poller.error_epoll_iter)),
            (topic, "read_messages", _limited(topic.read_messages)),
            (service, "read_messages", _limited(service.read_messages)),
            (client, "read_messages", _limited(client.read_messages, OK_SIZE)),
            (tcpros_service, "recv_buff", receive_error), (tcpros_service.ServiceImpl, "handle", handle_or_close)]


def _is_still_publisher(topic, uri):
    """Ask a publisher whether it still is one. One that doesn't answer in time may be frozen: it's asked again."""
    try:
        code, _, topics = call(uri, "getPublications", rospy.get_name())
        return code == 1 and any(name == topic for name, _ in topics)
    except socket.timeout:
        return True
    except Exception:
        return False


def _remove_connection(self, connections, gone):
    """Remove a connection from a topic's list and close it. Takes the place of ``_TopicImpl._remove_connection``.

    The kernel takes a closed connection out of rospy's epoll by itself, where no child process that is about to start
    holds it; see ``_confirmed``.
    """
    transport = _transport(gone)
    connections[:] = [each for each in connections if _transport(each) is not transport]
    with suppress(Exception):  # of what is called when it has closed
        gone.close()


def _transport(connection):
    """Return what a queue of messages for a subscriber sends them over, or the connection itself."""
    return vars(connection).get("_connection", connection)


def _locked(check):
    """Return ``_TopicImpl.check`` so that no connection is added between what it finds and what it removes."""
    def check_locked(self):
        with self.c_lock:
            check(self)
    return check_locked


def _confirmed(broken):
    """Return ``Poller.error_epoll_iter`` so that it names only descriptors that are broken now.

    epoll goes on naming a closed one that a child process still holds, by a number that may be another connection's.
    """
    def broken_now(self):
        for descriptor in broken(self):
            now = select.poll()
            now.register(descriptor, select.POLLRDHUP)
            if now.poll(0):
                yield descriptor
    return broken_now


def _unknown(replacements):
    """Name what is different in this rospy from the one that the limits were made for; empty = nothing."""
    for owner, name, replacement in replacements:
        taken = inspect.signature(getattr(owner, name)).parameters
        try:
            inspect.signature(replacement).bind(*taken)
        except TypeError:
            return f"{owner.__name__}.{name} takes {', '.join(taken)}"
    return ""


def limit_connections() -> str:
    """Have this process's connections use the limits. To be called before ``rospy.init_node``.

    Returns:
        Why they don't, a line for the log: this rospy is another one and stays as it is. Empty = they do.
    """
    if tcpros_pubsub.check_if_still_publisher is _is_still_publisher:
        return ""
    try:
        replacements = _replacements()
        unknown = _unknown(replacements)
    except AttributeError as error:
        unknown = str(error)
    if unknown:
        return (f"the time limits for handshakes are made for another rospy than this one ({unknown}), so there are "
                "none: one silent connection keeps all later subscribers from this node (docs/security.md)")
    for owner, name, value in replacements:
        setattr(owner, name, value)
    return ""


def _empty(buffer):
    buffer.seek(0)
    buffer.truncate()


def _address(connection):
    try:
        return "{}:{}".format(*connection.getpeername())
    except OSError:
        return "a peer that has gone"


def _clip(text):
    return "".join(filter(str.isprintable, " ".join(str(text).split())))[:MAX_REPORT]
