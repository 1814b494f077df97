"""Keeps a peer that is silent, or announces too much, from holding up this process's TCPROS connections.

rospy reads the header of a new connection in the thread that accepts connections, and waits for it without a time
limit: after one silent peer nobody else is connected. It waits as long for the header of a publisher, and buffers a
message of any length that a peer announces. Here

- each handshake of a server has a thread and ``HANDSHAKE_S`` for its whole header; of more than ``MAX_HANDSHAKES``
  the oldest is dropped,
- a publisher or a service has as long for the header with which it answers; the subscriber then tries again, with
  rospy's back-off,
- a message or a header that is announced as longer than ``MAX_MESSAGE_SIZE`` or ``MAX_HEADER_SIZE`` closes the
  connection.

An established connection blocks as before. See http://wiki.ros.org/ROS/TCPROS for the protocol.
"""
from __future__ import annotations

import inspect
import itertools
import logging
import socket
import struct
import sys
import threading
import traceback
from contextlib import suppress
from typing import Any, NamedTuple

import rospy
from rosgraph.network import decode_ros_handshake_header, write_ros_handshake_header
from rospy.exceptions import TransportException, TransportInitError
from rospy.impl import tcpros_base, tcpros_pubsub, tcpros_service
from rospy.impl.transport import INBOUND
from rospy.service import ServiceException

from car_interface.common.units import NS_PER_S
from car_interface.ros.clocks import SYSTEM
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.xmlrpc_calls import call

HANDSHAKE_S = 1.0  # a header arrives within a round trip: 0.2 ms on one computer, 2 to 100 ms over Wi-Fi
MAX_HANDSHAKES = 64
# None is dropped before it has lasted so long, which is a slow round trip: a flood of connections must not end that of
# a real subscriber. Until then new connections wait in the kernel's queue, so that a flood of them is taken at
# MAX_HANDSHAKES / MIN_HANDSHAKE_S = 640 a second at most, and the whole queue in 1.6 s.
MIN_HANDSHAKE_S = 0.1
ACCEPT_QUEUE = 1024  # rospy's 5 would overflow, and the kernel tries again a second later
ROOM_POLL_S = 0.005
ACCEPT_PAUSE_S = 0.1  # after an error, such as too many open files
MAX_MESSAGE_SIZE = 16_000_000  # bytes; this package's longest message has some 10 kB, a camera's image 6 MB
MAX_HEADER_SIZE = 256_000  # bytes; MAX_HANDSHAKES of them are one message. The longest definitions have some 100 kB
MAX_REPORT = 300  # characters of an error that a peer may have written
LENGTH = struct.Struct("<I")  # before a header and before a message
OK_SIZE = 1  # of the byte before a service's response
REFUSAL_KINDS = 64

_log = logging.getLogger("car_interface")


class HandshakeError(TransportInitError):
    """A connection was not made."""


class HandshakeTimeout(HandshakeError):
    """The peer took longer than ``HANDSHAKE_S``."""


class PeerGone(HandshakeError):
    """The peer has closed the connection."""


class _Replaced(HandshakeError):
    """The peer has made a newer connection meanwhile."""


class MessageTooLong(TransportException, ServiceException):
    """A peer announced a message that is longer than ``MAX_MESSAGE_SIZE``.

    As a ``ServiceException`` it passes ``receive_once`` unchanged; as a ``TransportException`` it has a subscriber
    connect again.
    """


_warnings = ThrottledWarnings(SYSTEM)


def read_header(connection: socket.socket) -> dict[str, str]:
    """Read the header with which a peer begins, and leave the connection without a time limit.

    Raises:
        HandshakeTimeout: it is not whole within ``HANDSHAKE_S``.
        HandshakeError: the peer has gone, or sends no header.
    """
    peer = _address(connection)
    deadline_s = SYSTEM.now_ns() / NS_PER_S + HANDSHAKE_S
    try:
        prefix = _receive(connection, LENGTH.size, deadline_s)
        size, = LENGTH.unpack(prefix)
        if size > MAX_HEADER_SIZE:
            raise HandshakeError(f"{peer} announces a header of {size} bytes, more than {MAX_HEADER_SIZE}")
        header = decode_ros_handshake_header(prefix + _receive(connection, size, deadline_s))
        connection.settimeout(None)
        return header
    except socket.timeout:
        raise HandshakeTimeout(f"{peer} sent no whole header within {HANDSHAKE_S:g} s") from None
    except EOFError:
        raise PeerGone(f"{peer} closed the connection before its header was whole") from None
    except OSError as error:
        raise PeerGone(f"{peer} has gone ({error})") from None
    except HandshakeError:
        raise
    except Exception as error:  # decoding raises several
        raise HandshakeError(f"{peer} sends no TCPROS header ({_clip(error)})") from None


def _receive(connection, size, deadline_s):
    received = bytearray()
    while len(received) < size:
        # After the deadline what is there already is still read: this process may have stood still meanwhile.
        connection.settimeout(max(0.0, deadline_s - SYSTEM.now_ns() / NS_PER_S))
        try:
            part = connection.recv(size - len(received))
        except BlockingIOError:
            raise socket.timeout from None
        if not part:
            raise EOFError
        received += part
    return bytes(received)


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


class _Handshake(NamedTuple):
    connection: socket.socket
    began_s: float


class _Handshakes:
    """Those of this process's TCPROS server."""

    def __init__(self):
        self._lock = threading.Lock()
        self._numbers = itertools.count()
        self._waiting: dict[int, _Handshake] = {}  # for their header, by number, oldest first
        self._handing_on = threading.Lock()
        self._newest: dict[tuple[str, str], int] = {}  # by topic and subscriber; of the last MAX_HANDSHAKES

    def begin(self, server: Any, connection: socket.socket, address: tuple) -> None:
        """Take a connection. Called in the thread that accepts them."""
        self._make_room()
        with self._lock:
            number = next(self._numbers)
            self._waiting[number] = _Handshake(connection, SYSTEM.now_ns() / NS_PER_S)
        try:
            threading.Thread(target=self._run, args=(server, connection, address, number), daemon=True).start()
        except RuntimeError as error:  # no more threads
            self._end_waiting(number)
            connection.close()
            _warnings.warn("thread", f"Inbound TCP/IP connection failed: {error}")

    def _make_room(self):
        while True:
            with self._lock:
                if len(self._waiting) < MAX_HANDSHAKES:
                    return
                number, oldest = next(iter(self._waiting.items()))
                left_s = oldest.began_s + MIN_HANDSHAKE_S - SYSTEM.now_ns() / NS_PER_S
                if left_s <= 0:
                    del self._waiting[number]
                    _shut_down(oldest.connection)  # wakes its thread, which closes it
                    return
            SYSTEM.sleep(min(left_s, ROOM_POLL_S))

    def _end_waiting(self, number):
        """Return whether it was waiting, and not dropped before."""
        with self._lock:
            return self._waiting.pop(number, None) is not None

    def _run(self, server, connection, address, number):
        try:
            try:
                header = read_header(connection)
            finally:
                was_waiting = self._end_waiting(number)
            if not was_waiting:
                raise HandshakeError(f"{_named(address)} was dropped")
            self._hand_on(server, connection, address, header, number)
        except Exception as error:
            connection.close()
            if not rospy.core.is_shutdown_requested():
                self._report(error, address, was_waiting)

    @staticmethod
    def _report(error, address, was_waiting):
        if not was_waiting:
            _warnings.warn("dropped", f"Inbound TCP/IP connection failed: {_named(address)} was dropped, since "
                                      f"{MAX_HANDSHAKES} newer ones wait for a header, too")
        elif isinstance(error, _Replaced):
            _log.info("%s", error)
        elif isinstance(error, HandshakeError):
            _warnings.warn(type(error).__name__, f"Inbound TCP/IP connection failed: {_clip(error)}")
        else:
            if not isinstance(error, OSError):
                _log.error("%s", traceback.format_exc())
            _warnings.warn(type(error).__name__, f"Inbound TCP/IP connection failed: {_named(address)}: {_clip(error)}")

    def _hand_on(self, server, connection, address, header, number):
        """Have rospy take a connection whose header is there."""
        # One at a time, as rospy's thread does it.
        with self._handing_on:
            if "topic" in header:
                refusal = self._hand_on_in_order(server, connection, address, header, number)
            elif "service" in header:
                refusal = server.service_connection_handler(connection, address, header)
            else:
                refusal = "no topic or service name detected"
        if not refusal:
            return
        is_ending = rospy.core.is_shutdown_requested()
        _write_header(connection, {"error": "node shutting down" if is_ending else refusal})
        connection.close()
        if not is_ending:
            caller = _clip(header.get("callerid", "a peer without a name"))
            # A kind for each caller, of which there may be any number.
            _warnings.warn(f"refused {hash(caller) % REFUSAL_KINDS}",
                           f"Could not process inbound connection of {caller} at {_named(address)}: {_clip(refusal)}")

    def _hand_on_in_order(self, server, connection, address, header, number):
        """Keep an older connection of a subscriber from taking the place of its newer one.

        rospy has one of each subscriber and drops the other. Accepted one after the other, two of them may get their
        headers at the same time.
        """
        key = header["topic"], header.get("callerid", "")
        if self._newest.get(key, -1) > number:
            raise _Replaced(f"{_clip(key[1])} has connected to {_clip(key[0])} again meanwhile")
        refusal = server.topic_connection_handler(connection, address, header)
        if not refusal:
            self._newest.pop(key, None)
            self._newest[key] = number
            if len(self._newest) > MAX_HANDSHAKES:
                del self._newest[next(iter(self._newest))]
        return refusal


_handshakes = _Handshakes()


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
        _shut_down(connection)
        raise MessageTooLong(f"{peer} announces a message of {size} bytes; more than {MAX_MESSAGE_SIZE} closes the "
                             "connection")


def _read_topic(self, buffer, messages, connection):
    """Take the place of ``read_messages`` of a subscription; of a message that is whole the length needs no check."""
    tcpros_base.deserialize_messages(buffer, messages, self.recv_data_class, queue_size=self.queue_size)
    if not messages:
        try:
            _check_length(buffer, 0, connection)
        except MessageTooLong as error:
            _warnings.warn(f"length {self.resolved_name}", f"{self.resolved_name}: {error}")
            raise


def _read_request(self, buffer, messages, connection):
    """Take the place of ``read_messages`` of a service."""
    tcpros_base.deserialize_messages(buffer, messages, self.recv_data_class, queue_size=self.queue_size)
    if not messages:
        _check_length(buffer, 0, connection)


def _replacements() -> list[tuple[Any, str, Any]]:
    """Return what takes the place of what in rospy: owner, attribute, new value."""
    server, transport, client = tcpros_base.TCPServer, tcpros_base.TCPROSTransport, tcpros_service.TCPROSServiceClient
    serve, create_socket, connect = server.run, server._create_server_sock, transport.connect
    read_response, read_error = client.read_messages, client._read_service_error
    handle, log_error = tcpros_service.ServiceImpl.handle, tcpros_base.rospyerr

    def begin_handshake(self, connection, address):
        _handshakes.begin(self, connection, address)

    def accept_until_shutdown(self):
        while True:
            try:
                serve(self)  # until an error, or the shutdown
                return
            except OSError as error:
                if self.is_shutdown or self.server_sock.fileno() < 0:
                    return
                _warnings.warn("accept", f"can't accept connections: {error}")
                SYSTEM.sleep(ACCEPT_PAUSE_S)

    def create_socket_with_queue(self):
        listener = create_socket(self)
        listener.listen(ACCEPT_QUEUE)
        return listener

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

    def read_response_of_length(self, buffer, messages, connection):
        read_response(self, buffer, messages, connection)
        if not messages:
            _check_length(buffer, OK_SIZE, connection)

    def read_error_of_length(self, connection, buffer):
        while buffer.tell() < OK_SIZE + LENGTH.size:
            tcpros_base.recv_buff(connection, buffer, OK_SIZE + LENGTH.size - buffer.tell())
        _check_length(buffer, OK_SIZE, connection)
        return read_error(self, connection, buffer)

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

    return [(server, "run", accept_until_shutdown), (server, "_create_server_sock", create_socket_with_queue),
            (tcpros_base.TCPROSServer, "_tcp_server_callback", begin_handshake),
            (tcpros_base, "read_ros_handshake_header", _read_header_into),
            (tcpros_base, "write_ros_handshake_header", _write_header),
            (tcpros_base, "rospyerr", log_other_error),
            (transport, "connect", connect_or_be_ready_again),
            (tcpros_pubsub.TCPROSSub, "read_messages", _read_topic),
            (tcpros_pubsub, "check_if_still_publisher", _is_still_publisher),
            (tcpros_service.TCPService, "read_messages", _read_request),
            (client, "read_messages", read_response_of_length),
            (client, "_read_service_error", read_error_of_length),
            (tcpros_service.ServiceImpl, "handle", handle_or_close)]


def _is_still_publisher(topic, uri):
    """Ask a publisher whether it still is one. One that doesn't answer in time may be frozen: it's asked again."""
    try:
        code, _, topics = call(uri, "getPublications", rospy.get_name())
        return code == 1 and any(name == topic for name, _ in topics)
    except socket.timeout:
        return True
    except Exception:
        return False


def unknown_in_rospy() -> str:
    """Name what is different in this rospy from the one that the limits were made for; empty = nothing."""
    try:
        for owner, name, replacement in _replacements():
            taken = inspect.signature(getattr(owner, name)).parameters
            try:
                inspect.signature(replacement).bind(*taken)
            except TypeError:
                return f"{owner.__name__}.{name} takes {', '.join(taken)}"
    except AttributeError as error:
        return str(error)
    owners = (tcpros_pubsub.TCPROSSub, tcpros_service.TCPService)  # whose base's method is replaced
    return next((f"{owner.__name__} has a read_messages of its own" for owner in owners
                 if "read_messages" in vars(owner)), "")


def limit_connections() -> str:
    """Have this process's connections use the limits. To be called before ``rospy.init_node``.

    Returns:
        Why they don't, a line for the log: this rospy is another one and stays as it is. Empty = they do.
    """
    if tcpros_pubsub.check_if_still_publisher is _is_still_publisher:
        return ""
    unknown = unknown_in_rospy()
    if unknown:
        return (f"the time limits for handshakes are made for another rospy than this one ({unknown}), so there are "
                "none: one silent connection keeps all later subscribers from this node (docs/security.md)")
    for owner, name, value in _replacements():
        setattr(owner, name, value)
    return ""


def _empty(buffer):
    buffer.seek(0)
    buffer.truncate()


def _shut_down(connection):
    """End a connection that another thread uses, and will close."""
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def _address(connection):
    try:
        return _named(connection.getpeername())
    except OSError:
        return "a peer that has gone"


def _named(address):
    return f"{address[0]}:{address[1]}"


def _clip(text):
    return "".join(filter(str.isprintable, " ".join(str(text).split())))[:MAX_REPORT]
