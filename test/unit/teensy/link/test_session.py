"""A session with a Teensy: bytes and times in; events, and bytes to send, out. Frames are the simulated firmware's."""

import math
import struct

import pytest

from car_interface.sim.teensy_uart import frame_body
from car_interface.teensy.link.framing import CORRECTED, RESYNC_FILLER, SHIPPED
from car_interface.teensy.link.health import ABSENT, FINE, REBOOTED, WAITING, WARN
from car_interface.teensy.link.pinging import AUTO, Answer
from car_interface.teensy.link.protocol import RESET_WHEELS, ErrorCount, Malformed, Pong, SonarStatus
from car_interface.teensy.link.session import PongReceived, Rebooted, Session

MS, S = 1_000_000, 1_000_000_000
NOW = 100 * S
GIVE_UP = S // 2
# A timestamp whose frame carries, so that the two checksums differ.
CARRIES = 0xffffffff
SHIPPED_PING = bytes.fromhex("7e 02010100 ffffffff 00000000 ff 7e")
CORRECTED_PING = bytes.fromhex("7e 02010100 ffffffff 00000000 fb 7e")


def from_teensy(command, payload):
    return b"\x7e" + frame_body(bytes((1, 2, command, 0)) + payload) + b"\x7e"


def pong(timestamp1, tick):
    return from_teensy(2, struct.pack("<II", timestamp1, tick))


def sonar(tick, sensor=1):
    return from_teensy(6, struct.pack("<BBHI", sensor, 0x55, 4000, tick))


def counter(name, count=1):
    return from_teensy(9, struct.pack("<I", count) + name.encode() + b"\0")


@pytest.fixture
def session():
    """Its port was just opened."""
    session = Session(115200, S, AUTO, NOW)
    session.opened(NOW)
    return session


def types(events):
    return [type(event) for event in events]


def test_first_ping_is_due_as_the_port_opens_and_goes_behind_the_filler(session):
    for openings in (1, 2):
        assert session.pinger.next_event_ns() == session.pinger.due_ns == NOW
        assert session.ping(CARRIES, NOW) == RESYNC_FILLER + SHIPPED_PING
        assert session.pinger.due_ns > NOW
        assert session.ping(CARRIES, NOW + S) == SHIPPED_PING
        assert (session.openings, session.resyncs) == (openings, openings)
        session.receive(sonar(5000)[:9], NOW)
        session.health.port_failed(ABSENT, "it is gone", "plug it in")
        assert (session.health.verdict.state, session.judge(NOW).state) == (ABSENT, ABSENT)
        session.opened(NOW)
        assert session.health.verdict.state == WAITING
        session.receive(sonar(5000)[1:], NOW)
        assert session.tally.bad_frames == 0  # the two halves are no frame


def test_pong_comes_with_the_answer_about_its_ping_and_one_without_a_ping_says_nothing_about_the_round_trip(session):
    assert session.receive(pong(7, 5000), NOW) == [PongReceived(Pong(7, 5000), None)]
    assert math.isnan(session.round_trip_ns) and session.pinger.answered_checksum is None
    session.ping(7, NOW)
    assert session.receive(pong(7, 5000), NOW + 4 * MS) == [PongReceived(Pong(7, 5000), Answer(NOW, 4 * MS, 15))]
    assert (session.pinger.sent, session.pinger.answered) == (1, 1)
    assert session.round_trip_ns == 4 * MS and session.pinger.answered_checksum == SHIPPED


def let_pings_expire(session, count, data=b""):
    expired, now_ns = [], NOW
    for number in range(count):
        session.ping(number, now_ns)
        session.receive(data, now_ns)
        now_ns += GIVE_UP
        expired += session.expire(now_ns)
    return expired, now_ns


def test_other_checksum_is_tried_when_no_ping_is_answered_though_frames_come(session):
    expired, now_ns = let_pings_expire(session, 5, sonar(5000))
    assert expired == list(range(5))
    assert session.pinger.checksum == CORRECTED and session.pinger.answered_checksum is None
    assert session.resyncs == 1 + 4
    assert session.ping(CARRIES, now_ns).endswith(CORRECTED_PING)
    session.receive(pong(CARRIES, 9000), now_ns + MS)
    assert session.pinger.answered_checksum == CORRECTED


@pytest.mark.parametrize("data", [b"", from_teensy(99, b"")], ids=["nothing", "malformed_frames"])
def test_checksum_stays_while_nothing_proves_that_the_teensy_is_there(session, data):
    session.receive(sonar(5000), NOW)  # once
    expired, _ = let_pings_expire(session, 7, data)  # after 5 it would try the other one
    assert len(expired) == 7 and session.pinger.checksum == SHIPPED


def test_checksum_that_answers_is_that_of_the_ping_not_of_the_next_one(session):
    """The pong to a ping with the shipped checksum may come after the other one was chosen."""
    for number in range(6):
        session.ping(number, NOW + number)
    session.receive(sonar(5000), NOW)
    session.expire(NOW + GIVE_UP + 4)
    assert session.pinger.checksum == CORRECTED
    session.receive(pong(5, 5000), NOW + GIVE_UP + 4)
    assert session.pinger.answered_checksum == SHIPPED


def test_command_is_sent_with_the_checksum_of_the_pings():
    frames = {checksum: Session(115200, S, checksum, NOW).encode(RESET_WHEELS) for checksum in (SHIPPED, CORRECTED)}
    assert frames[SHIPPED] == frames[CORRECTED] == bytes.fromhex("7e 02010800 f4 7e")  # it carries nothing
    assert Session(115200, S, CORRECTED, NOW).ping(CARRIES, NOW) == CORRECTED_PING


def test_reboot_is_an_event_before_the_record_that_shows_it(session):
    for index in range(3):
        assert types(session.receive(sonar(90_000 + 60 * index), NOW + 60 * index * MS)) == [SonarStatus]
    events = session.receive(sonar(100) + sonar(160), NOW + 300 * MS)
    assert types(events) == [SonarStatus, Rebooted, SonarStatus]
    assert events[1].description == "its clock went from 90.1 s back to 0.2 s"
    assert session.reboots == 1


def test_reboot_is_the_verdict_on_a_link_that_is_fine(session):
    for second in range(1, 6):
        now_ns = NOW + second * S
        session.ping(second, now_ns)
        session.receive(pong(second, 90_000 + 1000 * second) + sonar(90_010 + 1000 * second) * 20, now_ns)
        session.judge(now_ns)
    assert session.health.verdict.state == FINE
    session.receive(sonar(100) + sonar(160), now_ns + MS)
    assert session.health.verdict[:3] == (
        REBOOTED, WARN, "the Teensy rebooted: its clock went from 95.0 s back to 0.2 s")


def test_pong_shows_a_reboot_too_and_is_followed_by_quick_pings(session):
    now_ns = NOW
    for number in range(40):
        now_ns = session.pinger.due_ns
        session.ping(number, now_ns)
        session.receive(pong(number, 90_000 + (now_ns - NOW) // MS), now_ns)
    assert session.pinger.due_ns > now_ns + S // 2  # quick no more
    session.ping(50, now_ns)
    session.ping(51, now_ns + MS)
    events = session.receive(pong(50, 100) + pong(51, 101), now_ns + 2 * MS)
    assert types(events) == [PongReceived, Rebooted, PongReceived]
    session.ping(52, now_ns + 3 * MS)
    session.receive(pong(52, 103), now_ns + 4 * MS)
    assert session.pinger.due_ns < now_ns + S // 2


@pytest.mark.parametrize("lag_ms, reboots", [(0, 0), (1_900, 0), (2_100, 1)])
def test_pong_that_lags_the_time_since_the_one_before_shows_a_reboot_that_the_clock_hides(session, lag_ms, reboots):
    session.ping(1, NOW)
    session.receive(pong(1, 5_000), NOW)
    session.opened(NOW + 10 * S)
    for number in (2, 3):
        session.ping(number, NOW + 10 * S)
        session.receive(sonar(14_990 - lag_ms) + pong(number, 14_990 - lag_ms), NOW + 10 * S)
    assert session.reboots == reboots


def test_counters_are_kept_by_name_as_last_sent_and_no_more_names_than_noise_may_make_up(session):
    events = session.receive(counter("rxPackets", 5) + counter("pingFail") + counter("rxPackets", 8), NOW)
    assert events == [ErrorCount(5, "rxPackets"), ErrorCount(1, "pingFail"), ErrorCount(8, "rxPackets")]
    assert session.counters == {"rxPackets": 8, "pingFail": 1}
    for number in range(100):
        session.receive(counter(f"noise{number}"), NOW)
    session.receive(counter("noise0", 77), NOW)
    assert len(session.counters) == 64 and session.counters["noise0"] == 77


def test_malformed_frames_are_counted_and_those_of_an_unknown_command_once_more(session):
    events = session.receive(from_teensy(99, b"") + from_teensy(6, b"short"), NOW)
    assert types(events) == [Malformed, Malformed]
    assert (session.malformed, session.unknown_commands) == (2, 1)
    assert session.counts().records == 0 and session.tally.frames == 2
