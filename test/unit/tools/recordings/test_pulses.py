"""The wheels' pulses of a recording: their times, their direction, and what is left out."""
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.recordings.columns import Timeline
from car_interface.tools.recordings.pulses import CLOCK_TOPIC, WHEEL_TOPIC, PulseColumns
from car_interface.tools.recordings.recording import Recorded
from car_interface.tools.recordings.signals import PULSES, load
from written_recordings import START_NS, Written, stamp, write_ros1


def wheel(time_s, left, right, tick, left_turned_at=0):
    one = {"speed": 10, "when": tick}
    return Written(time_s, "/teensy_wheel", "car_interface/Wheel", {
        "left": {**one, "dist_abs": left, "dist": left_turned_at, "direction": int(left_turned_at > 0)},
        "right": {**one, "dist_abs": right}})


def clock(time_s, tick):
    monotonic_ns = round(time_s * 1e9) + 7_000_000_000
    return Written(time_s, "/teensy_clock", "car_interface/TeensyClock", {
        "stamp": stamp(time_s), "sent": monotonic_ns - 4_000_000, "received": monotonic_ns, "sent_bytes": 15,
        "baud": 115200, "tick": tick})


def test_pulses_are_when_the_wheels_made_them_backward_ones_taken_off(tmp_path):
    messages = [clock(0.2 * index, 1000 + 200 * index) for index in range(20)]
    messages += [wheel(0.5 + 0.05 * index, index, 2 * index, 1450 + 50 * index) for index in range(60)]
    messages += [wheel(3.5 + 0.05 * index, 60 + index, 118, 4450 + 50 * index, left_turned_at=60) for index in range(5)]
    path = write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda message: message.time_s))
    left, right = load(str(path), [PULSES]).pulses
    assert left.count[-1] == max(left.count) - 5 and right.count[-1] == 2 * 59
    made_s = dict(zip(right.count.tolist(), right.t_s))
    assert made_s[100] == pytest.approx(0.45 + 0.05 * 50, abs=0.02)
    assert np.all(np.diff(left.t_s) > 0)


# --- columns ---


class Recording:
    """Adds reports to columns, with recording times in seconds since START_NS."""

    def __init__(self):
        self.columns, self._timeline = PulseColumns(WHEEL_TOPIC), Timeline()
        self._timeline.recorded_s(START_NS)

    def wheels(self, time_s, tick, left, right, direction=0):
        """Both wheels with that many pulses (not negative) since power-up, all in one direction: 0 is forward."""
        sides = (SimpleNamespace(speed=20, direction=direction, when=tick, dist=0, dist_abs=count)
                 for count in (left, right))
        self._add(time_s, WHEEL_TOPIC, SimpleNamespace(**dict(zip(("left", "right"), sides))))

    def pong(self, time_s, tick):
        received = round(time_s * 1e9) + 7_000_000_000  # the monotonic clock
        time_ns = START_NS + round(time_s * 1e9)
        self._add(time_s, CLOCK_TOPIC, SimpleNamespace(
            stamp=SimpleNamespace(sec=time_ns // 10**9, nanosec=time_ns % 10**9), sent=received - 4_000_000,
            received=received, sent_bytes=15, baud=115200, tick=tick))

    def _add(self, time_s, topic, message):
        time_ns = START_NS + round(time_s * 1e9)
        self.columns.add(Recorded(time_ns, topic, message), self._timeline.recorded_s(time_ns), self._timeline)

    def build(self):
        self.columns.finish(self._timeline)
        return self.columns.build()


def test_columns_are_empty_without_a_pulse():
    recording = Recording()
    recording.pong(0.0, 1000)
    for index in range(5):
        recording.wheels(0.1 * index, 1000 + 100 * index, 0, 0)
    left, right = recording.build()
    assert recording.columns.is_empty and len(left.t_s) == len(right.count) == 0
    assert recording.columns.notes() == []


def test_without_a_pong_pulses_count_by_the_arrival_of_their_reports():
    recording = Recording()
    for index in range(20):
        recording.wheels(1.0 + 0.1 * index, 5000 + 100 * index, 10 + index, 30)
    assert recording.columns.is_empty  # until it is known that no pong follows
    left, right = recording.build()
    assert not recording.columns.is_empty
    assert np.diff(left.count).tolist() == [1] * (len(left.count) - 1) and len(left.count) >= 19
    assert left.t_s[-1] == pytest.approx(2.9, abs=0.02)
    assert np.diff(left.t_s) == pytest.approx(0.1, abs=0.02)
    assert len(right.t_s) <= 1


def test_time_of_a_pulse_is_its_tick_and_not_the_arrival_of_its_report():
    recording = Recording()
    recording.pong(0.0, 1000)
    for index in range(1, 40):
        late_s = 0.06 if index == 30 else 0.0
        recording.wheels(0.1 * index + late_s, 1000 + 100 * index, 10 + index, 10 + index)
        recording.pong(0.1 * index + 0.07, 1070 + 100 * index)
    left, right = recording.build()
    assert left.t_s[-10:] == pytest.approx(0.1 * np.arange(30, 40), abs=0.01)
    assert right.t_s == pytest.approx(left.t_s, abs=1e-5)


def test_impossible_report_is_left_out_and_noted():
    recording = Recording()
    recording.pong(0.0, 1000)
    for index in range(1, 10):
        recording.wheels(0.1 * index, 1000 + 100 * index, 10 + index, 10 + index)
    good = recording.columns.build()[0].count.tolist()
    recording.wheels(1.0, 2000, 1_000_000, 20)
    left, _ = recording.build()
    assert left.count.tolist() == good
    assert recording.columns.notes() == [
        "teensy_wheel: 1 reports of the wheels that make no sense: left out"]
