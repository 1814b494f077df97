"""The black box's memory: what it keeps, and for how long."""
from car_interface.common.units import NS_PER_S
from car_interface.nodes.black_box import MAX_MESSAGE_BYTES, MAX_PER_S, OVERHEAD_BYTES, SPAN_NS, Message, Ring

HEADER = {"type": "std_msgs/Bool", "callerid": "/planner", "latching": "0"}
LATCHED = {**HEADER, "latching": "1"}


def message(at_s, topic="/joy", data=b"data", header=HEADER):
    return Message(round(at_s * NS_PER_S), topic, header, data)


def filled(*messages, **bounds):
    ring = Ring(**bounds)
    for one in messages:
        ring.add(one)
    return ring


def seconds(ring):
    return [one.at_ns / NS_PER_S for one in ring.messages()]


def test_messages_of_the_last_minute_are_kept():
    assert seconds(filled(message(0.9), message(1), message(30), message(61))) == [1, 30, 61]
    assert SPAN_NS == 60 * NS_PER_S
    assert Ring().messages() == []


def test_oldest_go_first_where_memory_ends_and_a_large_message_is_left_out_and_counted():
    ring = filled(message(0), message(1), message(2), max_bytes=2 * (OVERHEAD_BYTES + len(b"data")))
    assert seconds(ring) == [1, 2]
    assert ring.size_bytes == 2 * (OVERHEAD_BYTES + 4)
    ring = filled(message(0, data=bytes(MAX_MESSAGE_BYTES + 1)), message(1, data=bytes(MAX_MESSAGE_BYTES)))
    assert (seconds(ring), ring.dropped) == ([1], 1)


def test_flooding_topic_pushes_no_other_out():
    flood = [message(5 + index / 1000, "/flood") for index in range(1000)]
    ring = filled(message(4), *flood, message(5.999), message(6, "/flood"))
    assert [one.topic for one in ring.messages()] == ["/joy", *["/flood"] * MAX_PER_S, "/joy", "/flood"]
    assert ring.dropped == 1000 - MAX_PER_S


def test_latched_message_from_before_is_kept_as_long_as_its_sender_sends_no_other():
    ring = filled(message(0, "/tf_static", b"old", LATCHED), message(1, "/tf_static", b"new", LATCHED), message(90))
    assert [(one.topic, one.data, one.at_ns) for one in ring.messages()] == [
        ("/tf_static", b"new", 90 * NS_PER_S), ("/joy", b"data", 90 * NS_PER_S)]
    ring.add(message(91, "/tf_static", b"newer", LATCHED))
    assert [one.data for one in ring.messages()] == [b"data", b"newer"]
