"""teensy_sensor_hub on its line: what firmware sent becomes messages, and what the hub sends is what firmware takes."""
import json
import os
import struct

import pytest
from car_interface.msg import Distance
from car_interface.srv import SetSonarSequenceRequest as Sequence
from car_interface.srv import SetSonarWaitRequest as Wait
from std_srvs.srv import TriggerRequest

from car import CONFIG
from graph import NS_PER_S, ROS_AHEAD_NS, START_NS
from teensy import FILLER, FLAG, PORT, Teensy, frame, sonar, unescaped, wheels

MS = 1_000_000
DATA = os.path.join(CONFIG, "..", "test", "data")
BYTES_PER_MS = 11  # at 115200 baud
TRIGGER = TriggerRequest()
TOPICS = {2: "/teensy_pong", 6: "/teensy_distance", 7: "/teensy_wheel", 9: "/teensy_error"}
# Header, payload and checksum. None of them carries or escapes: the shipped and the corrected checksum are the same.
SEQUENCE_015, SEQUENCE_ALL, SONAR_START = "0201030003000105f0", "0201030006000102030405e4", "02010500f7"


@pytest.fixture
def start(car):
    """Plug a Teensy in, start the hub, and return the Teensy."""
    car.graph.record(*TOPICS.values(), "/teensy_sensor_hub/link", "/odom", "/joint_states")

    def started(answers=True, delay_s=0.0, **parameters):
        car.cable.delay_s = delay_s
        teensy = Teensy(car.graph, car.cable, answers)
        car.hub(**parameters)
        car.graph.run(0)
        return teensy
    return started


@pytest.fixture
def call(car):
    """Call a service of the hub; return success and message."""
    def called(name, request=TRIGGER):
        answer = car.graph.call(f"/teensy_sensor_hub/{name}", request)
        return answer.success, answer.message
    return called


def fields_of_frame(line):
    if line["cmd"] == 2:
        return line["timestamp1"], line["timestamp2"]
    if line["cmd"] == 6:
        return line["sensor"], line["distance"], line["when"]
    if line["cmd"] == 7:
        return tuple(tuple(line[side][name] for name in ("speed", "direction", "when", "dist", "dist_abs"))
                     for side in ("left", "right"))
    return line["count"], line["name"]


def fields_of_message(message):
    return tuple(fields_of_message(value) if hasattr(value, "__slots__") else value
                 for value in (getattr(message, name) for name in message.__slots__))


@pytest.mark.parametrize("read_sizes, frame_s, phase_s", [
    ((4096,), 0.0, 0.0), ((4096,), 0.001, 0.0003), ((1,), 0.0, 0.0), ((3, 64, 7, 1), 0.002, 0.0)])
def test_every_frame_of_the_capture_becomes_its_message_however_its_bytes_are_read(
        car, start, read_sizes, frame_s, phase_s):
    with open(os.path.join(DATA, "capture_mixed.bin"), "rb") as file:
        stream = file.read()
    with open(os.path.join(DATA, "capture_mixed.jsonl"), encoding="utf-8") as file:
        lines = [line for line in map(json.loads, file) if line["cmd"] is not None]
    car.cable.read_sizes, car.cable.frame_s, car.cable.phase_s = read_sizes, frame_s, phase_s
    teensy = start(answers=False)
    for index, begin in enumerate(range(0, len(stream), BYTES_PER_MS)):
        car.graph.after(index / 1000, lambda begin=begin: teensy.write(stream[begin:begin + BYTES_PER_MS]))
    car.graph.run(len(stream) / BYTES_PER_MS / 1000 + 0.1)
    for cmd, count in ((2, 101), (6, 218), (7, 445), (9, 31)):
        expected = [fields_of_frame(line) for line in lines if line["cmd"] == cmd]
        assert len(expected) == count
        assert [fields_of_message(message) for message in car.graph.messages(TOPICS[cmd])] == expected


def test_opening_sends_the_filler_and_then_a_ping_that_the_shipped_receiver_takes(start):
    teensy = start(answers=False)
    at_ns, ping = teensy.pings[0]
    assert at_ns == START_NS
    assert teensy.written == FILLER + FLAG + ping + FLAG
    assert sum(byte for byte in ping if byte != 0x7D) % 256 == 0xFF  # without carry, over what is on the wire
    sent_ms = (START_NS + ROS_AHEAD_NS) // MS % 2 ** 32
    assert unescaped(ping)[4:12] == struct.pack("<II", sent_ms, 0)


@pytest.mark.parametrize("name, request_, on_wire", [
    ("sonar_start", TRIGGER, SONAR_START), ("sonar_stop", TRIGGER, "02010400f8"),
    ("wheel_reset", TRIGGER, "02010800f4"),
    ("get_counters", TRIGGER, "02010a00f2"), ("set_sonar_sequence", Sequence([0, 1, 5]), SEQUENCE_015),
    ("set_sonar_sequence", Sequence(list(range(6))), SEQUENCE_ALL), ("set_sonar_wait", Wait(50), "02010c0032000000be")])
def test_service_sends_its_command_at_once(car, start, call, name, request_, on_wire):
    teensy = start()
    car.graph.run(0.3)
    assert call(name, request_)[0]
    assert teensy.commands == [(car.graph.now_ns, on_wire)]
    assert bytes.fromhex(f"7e{on_wire}7e") in teensy.written
    assert car.graph.now_ns - START_NS == 300 * MS
    teensy.close()
    car.graph.run(1.0)
    assert call(name, request_) == (False, "the Teensy's port is not open")


@pytest.mark.parametrize("name, request_, reason", [
    ("set_sonar_sequence", Sequence([0, 6]), "there is no sonar 6: ids go from 0 to 5"),
    ("set_sonar_wait", Wait(2 ** 31), "a sonar wait is 0 to 2147483647 ms, not 2147483648")])
def test_bad_argument_is_refused_with_the_reason_and_nothing_is_sent(start, call, name, request_, reason):
    teensy = start()
    assert call(name, request_) == (False, reason)
    assert teensy.commands == []


def test_counters_are_sent_for_once_a_second_at_most_over_a_reconnect_too(car, start, call):
    teensy = start()
    asked_ns = car.graph.now_ns
    sent = (True, "sent; the counters come on teensy_error")
    refused = (False, "asked less than a second ago: the Teensy's buffers can't take more")
    assert call("get_counters") == sent
    teensy.close()
    car.graph.run(0.1)
    teensy = Teensy(car.graph, car.cable)
    car.graph.run(0.899999)
    assert car.cable.port is not None
    assert call("get_counters") == refused
    car.graph.run((asked_ns + NS_PER_S - car.graph.now_ns) / NS_PER_S)
    assert call("get_counters") == sent
    assert len(teensy.commands) == 1


def test_ping_service_waits_for_its_pong_and_says_how_long_or_that_none_came(car, start, call):
    teensy = start(delay_s=0.002)
    car.graph.run(0.1)
    assert call("ping") == (True, "pong after 4.0 ms")
    asked_ns = car.graph.now_ns
    teensy.answers = False
    both = [car.graph.begin_call("/teensy_sensor_hub/ping", TRIGGER) for _ in range(2)]
    assert {(answer.success, answer.message) for answer in [call_.finish() for call_ in both]} == {
        (False, "no pong came back")}
    assert car.graph.now_ns - asked_ns == 500 * MS


@pytest.mark.parametrize("after_s, message", [
    (0.0, "the Teensy's port is not open"),
    (0.1, f"Teensy on {PORT}: the port was lost. Check its cable and power")])
def test_ping_service_says_so_when_the_port_is_lost_while_it_waits(car, start, after_s, message):
    teensy = start(answers=False)
    call_ = car.graph.begin_call("/teensy_sensor_hub/ping", TRIGGER)
    car.graph.after(after_s, teensy.close) if after_s else teensy.close()
    answer = call_.finish()
    assert (answer.success, answer.message) == (False, message)
    assert car.graph.now_ns - START_NS == round(after_s * NS_PER_S)


def test_hub_that_ends_answers_who_waits_and_closes_the_port(car, start):
    start(answers=False)
    call_ = car.graph.begin_call("/teensy_sensor_hub/ping", TRIGGER)
    car.graph.run(0.01)
    car.graph.nodes["/teensy_sensor_hub"].end()
    answer = call_.finish()
    assert (answer.success, answer.message, car.cable.port) == (False, "the node ends", None)


def test_port_is_tried_ever_more_rarely_and_opened_again_with_filler_and_ping(car, start, call):
    teensy = start()
    car.graph.run(0.95)
    teensy.close()
    lost_ns = car.graph.now_ns
    node = car.graph.nodes["/teensy_sensor_hub"]
    car.graph.run(10)
    turns = node.turns
    tries_s = [(at_ns - lost_ns) / NS_PER_S for at_ns in car.cable.attempts_ns[1:]]
    assert tries_s == pytest.approx([0.2, 0.6, 1.4, 3.0, 5.0, 7.0, 9.0])
    car.graph.run(20)
    assert node.turns - turns <= 20 * 4  # of status, diagnostics and the port, and with nothing to do at most
    assert car.graph.lines("/teensy_sensor_hub", lost_ns, 30)[:2] == [
        f"Teensy on {PORT}: the port was lost. Check its cable and power",
        f"Teensy on {PORT}: there is no such port. Plug the Teensy in. Trying again"]
    teensy = Teensy(car.graph, car.cable)
    car.graph.run(2.0)
    assert teensy.written[:40] == FILLER + FLAG
    assert car.graph.newest("/teensy_sensor_hub/link").reconnects == 1
    teensy.write(sonar(2, 10000, 1))
    car.graph.run(0)
    assert car.graph.newest("/teensy_distance") == Distance(2, 10000, 1)
    teensy.close()
    tries = len(car.cable.attempts_ns)
    car.graph.run(0.2)
    assert len(car.cable.attempts_ns) == tries + 1  # as fast as at first


def test_report_that_came_too_soon_is_told_a_period_after_its_turn_though_no_other_follows(car, start):
    teensy = start(odom_rate=5)
    car.graph.run(1.0)
    begun_ns, begun_ms = car.graph.now_ns, teensy.tick_ms
    for left in (3, 4):
        teensy.write(wheels((left, 3), (teensy.tick_ms, begun_ms)))
        car.graph.run(0.02)
    car.graph.run(1.0)
    joints = [record for record in car.graph.recorded["/joint_states"] if record.at_ns >= begun_ns]
    first, last = (record.message.position for record in joints)
    assert last[0] > first[0] and last[1] == first[1]
    assert joints[0].at_ns == begun_ns
    assert joints[1].at_ns - begun_ns == 400 * MS


def test_flood_takes_half_of_the_computer_s_time_at_most(car, start):
    teensy = start()
    clocks, port = car.graph.nodes["/teensy_sensor_hub"].inbox.clocks, car.cable.port
    read, reads = port.read, []

    def slow_read():
        reads.append(car.graph.now_ns)
        clocks.sleep(0.006)
        return read()
    port.read = slow_read
    for index in range(2000):
        car.graph.after(index / 1000, lambda: teensy.write(bytes(range(256)) * 20))
    car.graph.run(2.0)
    assert 2.0 * 0.45 <= len(reads) * 0.006 <= 2.0 * 0.52
    assert len(teensy.pings) >= 4


def test_raw_only_hub_publishes_the_teensy_s_own_messages_and_measures_nothing(car, start):
    teensy = start(raw_only=True)
    teensy.write(sonar(2, 10000, 1) + wheels((3, 3), (5000, 5000)))
    car.graph.run(2.0)
    assert [len(car.graph.messages(topic)) for topic in ("/teensy_distance", "/teensy_wheel")] == [1, 1]
    assert len(car.graph.messages("/teensy_pong")) >= 5
    assert "/teensy_sensor_hub: Teensy clock" not in [
        status.name for array in car.graph.messages("/diagnostics") for status in array.status]
    assert not [topic for topic in ("/odom", "/joint_states", "/tf", "/tf_static", "/teensy_clock", "/sonar/rear_left")
                if car.graph.publishers[topic]]


def test_malformed_and_corrupt_frames_are_logged_once_each_and_counted(car, start):
    teensy = start()
    for _ in range(3):
        teensy.write(frame(b"\x01\x02\x63\x00") + FLAG + b"\x01\x02\x06\x00\x00\x00\x10\x27\x01\x00\x00\x00\x00" + FLAG)
        car.graph.run(0.1)
    car.graph.run(1.0)
    link = car.graph.newest("/teensy_sensor_hub/link")
    assert (link.malformed_frames, link.unknown_commands, link.bad_frames) == (3, 3, 3)
    lines = car.graph.lines("/teensy_sensor_hub", level=30)
    assert [line.partition(":")[0] for line in lines[:2]] == [
        "a frame from the Teensy makes no sense", "corrupt frames came from the Teensy"]


@pytest.mark.parametrize("parameters, expected", [
    ({}, []), ({"sonar_sequence": [0, 1, 5]}, [SEQUENCE_015])])
def test_sequence_of_the_parameters_is_sent_when_the_port_opens_and_after_a_reboot(car, start, parameters, expected):
    teensy = start(sonar_restart=0, **parameters)
    car.graph.run(3.0)
    assert [command for _, command in teensy.commands] == expected
    for tick_ms in (20_000, 20_100, 300, 400):
        teensy.write(sonar(2, 10000, tick_ms))
        car.graph.run(0.1)
    car.graph.run(2.0)
    assert [command for _, command in teensy.commands] == 2 * expected
    assert car.graph.newest("/teensy_sensor_hub/link").reboots >= 1
