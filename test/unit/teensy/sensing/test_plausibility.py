"""The gates together: on the captures, on clean drives, on anything, and on what the checksum can't see."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import BACKWARD, FORWARD
from car_interface.teensy.link.framing import FrameDecoder
from car_interface.teensy.link.protocol import UINT32, Malformed, Pong, SonarStatus, Wheel, WheelStatus, decode
from car_interface.teensy.sensing import plausibility as gates
from car_interface.teensy.sensing.plausibility import Gates, signed_pulses
from teensy_bench import CAPTURE
from wheel_reports import HARM_M, PULSE_M, counted, crawl, judged, proven


def records_of_the_capture():
    return [decode(body) for body in FrameDecoder().feed(CAPTURE)]


def through(some, records):
    verdicts = [some.wheels(record) if isinstance(record, WheelStatus)
                else some.sonar(record) if isinstance(record, SonarStatus) else some.pong(record, True)
                for record in records if isinstance(record, (WheelStatus, SonarStatus, Pong))]
    return counted(verdicts)


def test_nothing_of_the_golden_capture_is_refused_and_its_resets_are_seen():
    some = Gates()
    through(some, records_of_the_capture())
    assert (some.refused, some.accepted) == (0, 445 + 218 + 101)
    assert some.counts == {gates.FIRST: 2, gates.ODOMETERS_RESET: 2}


def drive(speeds_mps, seconds_each=1.0):
    """What a Teensy sends while the wheels turn at one speed after another, and the signed pulses that they make."""
    at_ns, position, made = 0, 0.0, 0
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=2 ** 32 - 2000, seed=1), lambda sensor, now_ns: 4000, at_ns)
    data = b""
    speed_mps = 0.0
    step_ns = 200_000
    for wanted_mps in speeds_mps:
        for _ in range(round(seconds_each * 1e9 / step_ns)):
            change = 20.0 * step_ns / 1e9  # m/s²
            speed_mps += max(-change, min(change, wanted_mps - speed_mps))
            at_ns += step_ns
            position += speed_mps * step_ns / 1e9 / PULSE_M
            while abs(position - made) >= 1:
                direction = FORWARD if position > made else BACKWARD
                made += 1 if direction == FORWARD else -1
                for side in (0, 1):
                    teensy.wheel_pulse(side, direction, at_ns)
            if at_ns % 1_000_000 == 0:
                data += teensy.transmit(at_ns)
    return data, made


@pytest.mark.once
@pytest.mark.parametrize("speeds_mps", [
    pytest.param([0.0, 0.05, 0.05, 0.0], id="crawl_of_5_cm_per_s"),
    pytest.param([0.0, 2.0, -2.0, 2.0, -2.0, 0.0], id="reversing"),
    pytest.param([0.0, 19.0, 19.0, 0.0, 0.0], id="almost_the_top_speed"),
])
def test_nothing_of_a_clean_drive_is_refused_and_each_pulse_counts(speeds_mps):
    data, made = drive(speeds_mps)
    some = Gates()
    assert through(some, [decode(body) for body in FrameDecoder().feed(data)]) == (made, made)
    assert some.refused == 0


@pytest.mark.once
@given(st.lists(st.integers(0, 3), min_size=30, max_size=200))
def test_reports_lost_anywhere_cost_no_pulse_once_three_have_come(kept):
    records = crawl(len(kept) + 3)
    heard = [record for record, keep in zip(records, [*kept, 1, 1, 1]) if keep]
    verdicts = judged(heard, Gates().wheels)
    first = heard[0].left.dist_abs
    assert first + proven(verdicts)[0] == records[-1].left.dist_abs


WHEELS = st.builds(Wheel, st.integers(0, 65535), st.integers(0, 3), st.integers(0, UINT32 - 1),
                   st.integers(0, UINT32 - 1), st.integers(0, UINT32 - 1))
SMALL_WHEELS = st.builds(Wheel, st.integers(0, 40), st.integers(0, 3), st.integers(0, 400), st.integers(0, 9),
                         st.integers(0, 9))
REPORTS = st.builds(WheelStatus, WHEELS | SMALL_WHEELS, WHEELS | SMALL_WHEELS)


@pytest.mark.once
@given(st.lists(REPORTS, max_size=30))
def test_gates_fed_anything_answer_and_take_up_a_crawl_after_at_most_three_reports(junk):
    some = Gates()
    judged(junk, some.wheels)
    verdicts = judged(crawl(6, 2 ** 30, start_ms=2 ** 30), some.wheels)
    assert [verdict.accepted for verdict in verdicts[2:]] == [True] * 4
    assert proven(verdicts[3:]) == (3, 3)


def wheel_bodies(data):
    return [body for body in FrameDecoder().feed(data) if isinstance(decode(body), WheelStatus)]


@pytest.mark.once
@pytest.mark.parametrize("bodies, index", [
    pytest.param(wheel_bodies(CAPTURE)[60:70], 4, id="capture_at_0.3_m_per_s"),
    pytest.param(wheel_bodies(drive([19.0, 19.0])[0])[-60:-50], 5, id="19_m_per_s"),
    pytest.param(wheel_bodies(drive([-2.0, 2.0, 2.0])[0])[-60:-50], 4, id="2_m_per_s_after_a_reversal"),
])
def test_any_two_flips_that_the_checksum_can_not_see_move_no_wheel_by_10_cm(bodies, index):
    """Exhaustive over the pairs of one column that differ, in a report with others around it; nothing is left of it."""
    body = bodies[index]
    for bit in range(8):
        ones = [place for place in range(4, 36) if body[place] >> bit & 1]
        zeros = [place for place in range(4, 36) if not body[place] >> bit & 1]
        for one, zero in itertools.product(ones, zeros):
            wrong = bytearray(body)
            wrong[one] ^= 1 << bit
            wrong[zero] ^= 1 << bit
            check_harm([*bodies[:index], bytes(wrong), *bodies[index + 1:]], bodies)


def check_harm(bodies, truth):
    some, moved, first = Gates(), (0, 0), decode(truth[0])
    for body, meant in zip(bodies, truth):
        record, right = decode(body), decode(meant)
        true = tuple(map(signed_pulses, first, right))
        if isinstance(record, Malformed):
            continue
        verdict = some.wheels(record)
        moved = tuple(map(sum, zip(moved, verdict.pulses)))
        if verdict.accepted:
            assert max(abs(have - meant) for have, meant in zip(moved, true)) * PULSE_M < HARM_M, (record, right)
    assert moved == true, decode(truth[0])
