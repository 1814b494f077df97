"""What the frames say. Bytes here are spelled out by hand from the protocol's table, or are from the golden capture."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.common.errors import ProtocolError
from car_interface.teensy.link import protocol
from car_interface.teensy.link.framing import encode
from car_interface.teensy.link.protocol import ErrorCount, Malformed, Pong, SonarStatus, Wheel, WheelStatus, decode


def body_of(text):
    return bytes.fromhex(text)


COMMANDS = {
    "ping": (lambda: protocol.ping(0x01020304), "02010100 04030201 00000000", "f1"),
    "ping_with_the_last_timestamp": (lambda: protocol.ping(2 ** 32 - 1), "02010100 ffffffff 00000000", "ff"),
    "sequence_of_key_x": (lambda: protocol.set_sonar_sequence([0, 1, 5]), "02010300 03 000105", "f0"),
    "sequence_of_one_as_rospy_delivers_it": (lambda: protocol.set_sonar_sequence(b"\x04"), "02010300 01 04", "f4"),
    "longest_sequence": (lambda: protocol.set_sonar_sequence([2] * 24), "02010300 18" + "02" * 24, "b1"),
    "sonar_stop": (lambda: protocol.STOP_SONARS, "02010400", "f8"),
    "sonar_start": (lambda: protocol.START_SONARS, "02010500", "f7"),
    "wheel_reset": (lambda: protocol.RESET_WHEELS, "02010800", "f4"),
    "get_counters": (lambda: protocol.SEND_COUNTERS, "02010a00", "f2"),
    "sonar_wait_of_0": (lambda: protocol.sonar_wait(0), "02010c00 00000000", "f0"),
    "longest_sonar_wait": (lambda: protocol.sonar_wait(2 ** 31 - 1), "02010c00 ffffff7f", "74"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_command_on_the_line_has_its_own_flags_and_the_receiver_s_checksum(name):
    command, body, checksum = COMMANDS[name]
    assert encode(command()) == b"\x7e" + body_of(body) + body_of(checksum) + b"\x7e"


@pytest.mark.parametrize("command, argument, message", [
    (protocol.set_sonar_sequence, [], "a sonar sequence has 1 to 24 entries, not 0"),
    (protocol.set_sonar_sequence, [0] * 25, "a sonar sequence has 1 to 24 entries, not 25"),
    (protocol.set_sonar_sequence, [0, 6], "there is no sonar 6: ids go from 0 to 5"),
    (protocol.set_sonar_sequence, [-1], "there is no sonar -1: ids go from 0 to 5"),
    (protocol.sonar_wait, -1, "a sonar wait is 0 to 2147483647 ms, not -1"),
    (protocol.sonar_wait, 2 ** 31, "a sonar wait is 0 to 2147483647 ms, not 2147483648"),
])
def test_command_that_the_teensy_could_not_take_is_refused_before_a_byte_is_made(command, argument, message):
    with pytest.raises(ProtocolError, match=message):
        command(argument)


RECORDS = [
    ("01020200 04030201 d2040000", Pong(timestamp1=0x01020304, timestamp2=1234)),
    ("01020600 00 00 6b11 057b0000", SonarStatus(sensor=0, echo_us=4459, when=31493)),
    ("01020600 05 25 0000 cc7e0000", SonarStatus(sensor=5, echo_us=0, when=32460)),  # garbage in its filler
    ("01020700 1400 01 00 caa90000 09000000 28000000 1500 00 00 c1a90000 23000000 29000000",
     WheelStatus(left=Wheel(speed=20, direction=1, when=43466, dist=9, dist_abs=40),
                 right=Wheel(speed=21, direction=0, when=43457, dist=35, dist_abs=41))),
    ("01020700 ffff 03 00 ffffffff ffffffff ffffffff 0100 03 00 00000000 00000000 00000000",
     WheelStatus(left=Wheel(65535, 3, 2 ** 32 - 1, 2 ** 32 - 1, 2 ** 32 - 1), right=Wheel(1, 3, 0, 0, 0))),
    ("01020900 01000000 61 00", ErrorCount(count=1, name="a")),
    ("01020900 ffffffff" + "78" * 23 + "00", ErrorCount(count=2 ** 32 - 1, name="x" * 23)),
]


@pytest.mark.parametrize("body, record", RECORDS)
def test_body_is_decoded_as_the_table_says(body, record):
    decoded = decode(body_of(body))
    assert decoded == record
    assert type(decoded) is type(record)


WHEEL = "0000 00 00 00000000 00000000 00000000"

MALFORMED = {
    # Our own ping, another sender, another receiver, nothing.
    "not from the Teensy to the host": ("02010100 00000000 00000000", "01010200 00000000 00000000",
                                        "02020200 00000000 00000000", ""),
    "the header's reserved byte isn't 0": ("01020201 00000000 00000000", "0102"),
    "unknown command 0": ("01020000",),
    "unknown command 1": ("01020100 00000000 00000000",),  # a ping from the Teensy
    "unknown command 255": ("0102ff00",),
    "11 bytes where this command has 12": ("01020200 00000000 000000", "01020600 00 00 6b11 057b00"),
    "13 bytes where this command has 12": ("01020200 00000000 00000000 00",),
    "20 bytes where this command has 36": ("01020700" + WHEEL,),
    "sensor above 5": ("01020600 06 00 6b11 057b0000",),
    "direction above 3": ("01020700 0000 04 00 00000000 00000000 00000000" + WHEEL,
                          "01020700" + WHEEL + "0000 04 00 00000000 00000000 00000000"),
    "a wheel's reserved byte isn't 0": ("01020700 0000 00 01 00000000 00000000 00000000" + WHEEL,
                                        "01020700" + WHEEL + "0000 00 01 00000000 00000000 00000000"),
    # Empty, cut in the count, without its NUL, with something behind that, or another NUL, too long, not ASCII.
    "a counter's name isn't": ("01020900 01000000 00", "01020900 0100", "01020900 01000000 6161",
                               "01020900 01000000 61 00 61", "01020900 01000000 61 00 00",
                               "01020900 01000000" + "78" * 24 + "00", "01020900 01000000 61 e9 00"),
}


@pytest.mark.parametrize("reason", MALFORMED)
def test_body_that_makes_no_sense_is_malformed_with_its_reason_and_bytes(reason):
    for body in map(body_of, MALFORMED[reason]):
        decoded = decode(body)
        assert isinstance(decoded, Malformed)
        assert decoded.reason.startswith(reason) and decoded.body == body


HEADERS = st.sampled_from([bytes((1, 2, command, 0)) for command in range(13)]) | st.binary(max_size=4)


@pytest.mark.once
@given(HEADERS, st.binary(max_size=40))
@example(b"\x01\x02\x09\x00", b"")
def test_decoding_anything_gives_a_record_and_never_raises(header, payload):
    record = decode(header + payload)
    if isinstance(record, SonarStatus):
        assert record.sensor <= 5
    elif isinstance(record, WheelStatus):
        assert record.left.direction <= 3 and record.right.direction <= 3
    elif isinstance(record, ErrorCount):
        assert 1 <= len(record.name) <= 23
    else:
        assert isinstance(record, (Pong, Malformed))
