"""A message is sent by the thread that publishes it, whole and in order, whichever subscriber hangs; and duties."""
import io
import socket
import struct
import threading
import time

import pytest

pytest.importorskip("rospy")

import rospy
from rospy.impl.tcpros_base import TCPROSTransport, TCPROSTransportProtocol
from rospy.impl.tcpros_pubsub import QueuedConnection

from car_interface.ros.topics import DirectConnection, duty_vector, one_channel_duty, send_directly
from loopback import PATIENCE_S, eventually

BIG = 300_000  # bytes: far less than a socket's buffers hold, far more than one segment
QUEUE = 10


class Link:
    """A connection of rospy to a subscriber, of which the test reads the other end."""

    def __init__(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            self.subscriber = socket.create_connection(server.getsockname())
            publisher, _ = server.accept()
        self.transport = TCPROSTransport(TCPROSTransportProtocol("topic", None), "topic")
        self.transport.set_socket(publisher, "subscriber")
        self.writers = set()
        self.pause_before, self.paused, self.go_on = b"", threading.Event(), threading.Event()
        relayed = self.transport.write_data

        def write_data(data):
            self.writers.add(threading.current_thread())
            if data == self.pause_before:
                self.paused.set()
                self.go_on.wait(PATIENCE_S)
            return relayed(data)
        self.transport.write_data = write_data
        self.connection = DirectConnection(self.transport, QUEUE)

    def receive(self, count):
        """The numbers of the next messages, each checked to be whole."""
        numbers = []
        for _ in range(count):
            number, size = struct.unpack("<II", self._read(8))
            assert set(self._read(size)) <= {number % 256}
            numbers.append(number)
        return numbers

    def _read(self, size):
        self.subscriber.settimeout(PATIENCE_S)
        data = b""
        while len(data) < size:
            part = self.subscriber.recv(size - len(data))
            assert part, "the connection ended"
            data += part
        return data

    def fill(self, size=BIG):
        """Send until the socket takes no more and the queue has dropped messages: how many were sent."""
        sent = 0
        while not self.connection._is_relaying:
            self.connection.write_data(message(sent, size))
            sent += 1
        eventually(lambda: not self.connection._rest)  # the thread has it
        for number in range(sent, sent + 3 * QUEUE):
            self.connection.write_data(message(number, size))
        return sent + 3 * QUEUE

    def close(self):
        self.transport.close()
        self.subscriber.close()
        self.connection._thread.join(PATIENCE_S)
        assert not self.connection._thread.is_alive()


def message(number, size=100):
    return struct.pack("<II", number, size) + bytes([number % 256]) * size


@pytest.fixture
def link():
    made = Link()
    yield made
    made.close()


def test_message_is_in_the_socket_when_publishing_returns_and_no_other_thread_has_sent_it(link):
    for number in range(5):
        link.connection.write_data(message(number, 92))
        link.subscriber.setblocking(False)
        assert link.subscriber.recv(1000) == message(number, 92)
    assert not link.writers
    assert (link.transport.stat_num_msg, link.transport.stat_bytes) == (5, 500)


def test_subscriber_that_does_not_read_delays_nobody_and_gets_the_newest_messages_whole_and_in_order_later(link):
    sent = link.fill()  # returns: nothing waits for the subscriber
    assert len(link.connection._queue) <= QUEUE
    numbers = link.receive(1)
    while numbers[-1] != sent - 1:
        numbers += link.receive(1)
    assert numbers == sorted(numbers) and numbers[-QUEUE:] == list(range(sent - QUEUE, sent))
    assert len(numbers) < sent  # older ones were dropped
    eventually(lambda: not link.connection._is_relaying)
    link.writers.clear()
    link.connection.write_data(message(5))  # directly again
    assert link.receive(1) == [5] and not link.writers


def test_message_that_is_sent_while_the_subscriber_catches_up_comes_after_those_that_wait(link):
    last = link.fill() - 1
    link.pause_before = message(last, BIG)  # the thread has that of its second time
    while link.receive(1) != [last - 1]:
        pass
    assert link.paused.wait(PATIENCE_S)
    link.connection.write_data(message(3))  # the socket has room now
    link.go_on.set()
    assert link.receive(2) == [last, 3]


def test_threads_that_publish_at_once_do_not_mix_their_messages(link):
    threads = [threading.Thread(target=lambda: [link.connection.write_data(message(1, 5000)) for _ in range(200)])
               for _ in range(4)]
    link.connection._queue_size = 0
    for thread in threads:
        thread.start()
    assert link.receive(800) == [1] * 800
    for thread in threads:
        thread.join()


def test_subscriber_that_has_gone_is_reported_by_a_later_message_as_rospy_does(link):
    link.subscriber.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    link.subscriber.close()  # with a reset
    until = time.monotonic() + PATIENCE_S
    with pytest.raises((OSError, rospy.exceptions.TransportException)):
        while time.monotonic() < until:
            link.connection.write_data(message(1))
            time.sleep(0.01)
    link.transport.close()
    link.connection.write_data(message(1))  # raises nothing once rospy has closed it


def test_publishers_of_the_process_use_it(monkeypatch):
    monkeypatch.setattr(rospy.topics, "QueuedConnection", QueuedConnection)
    send_directly()
    assert rospy.topics.QueuedConnection is DirectConnection


def test_command_of_one_channel_leaves_the_others_unchanged():
    assert one_channel_duty(2, 5100).data == [-1, -1, 5100] + [-1] * 13
    assert one_channel_duty(0, 5101).data == [5101] + [-1] * 15
    found = one_channel_duty(0, 5100)
    assert [(dim.label, dim.size, dim.stride) for dim in found.layout.dim] == [("pwm_channel", 16, 1)]
    buffers = [io.BytesIO() for _ in range(2)]
    for message, buffer in zip((found, duty_vector([5100] + [-1] * 15)), buffers):
        message.serialize(buffer)
    assert buffers[0].getvalue() == buffers[1].getvalue()
