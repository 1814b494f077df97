"""The wheels' pulses of a recording: their times, their direction, and what is left out."""
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.tools.recordings.columns import Timeline
from car_interface.tools.recordings.recording import Recorded
from car_interface.tools.recordings.replay import CLOCK_TOPIC, WHEEL_TOPIC, PulseColumns
from written_recordings import START_NS


class Recording:
    """Adds reports to columns, with recording times in seconds since START_NS."""

    def __init__(self):
        self.columns, self._timeline = PulseColumns(WHEEL_TOPIC), Timeline()
        self._timeline.recorded_s(START_NS)

    def wheels(self, time_s, tick, left, right, left_turned_at=0):
        """Both wheels with that many pulses since power-up, the left one's from a number on backward."""
        sides = (SimpleNamespace(speed=20, direction=int(turned_at > 0), when=tick, dist=turned_at, dist_abs=count)
                 for count, turned_at in ((left, left_turned_at), (right, 0)))
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
        """The pulses of both wheels."""
        return self.columns.build()[0]


def test_pulses_are_when_the_wheels_made_them_backward_ones_taken_off():
    recording = Recording()
    for step in range(75):
        if step % 4 == 0:
            recording.pong(0.05 * step, 1000 + 50 * step)
        if step >= 10:
            is_forward = step < 70
            recording.wheels(0.05 * step, 950 + 50 * step, step - 10, 2 * (step - 10) if is_forward else 118,
                             left_turned_at=0 if is_forward else 60)
    left, right = recording.build()
    assert left.count[-1] == max(left.count) - 5 and right.count[-1] == 2 * 59
    made_s = dict(zip(right.count.tolist(), right.t_s))
    assert made_s[100] == pytest.approx(0.45 + 0.05 * 50, abs=0.02)
    assert np.all(np.diff(left.t_s) > 0)


def test_columns_are_empty_without_a_pulse():
    recording = Recording()
    recording.pong(0.0, 1000)
    for index in range(5):
        recording.wheels(0.1 * index, 1000 + 100 * index, 0, 0)
    assert recording.columns.build() == (None, [])


def test_without_a_pong_pulses_count_by_the_arrival_of_their_reports():
    recording = Recording()
    for index in range(20):
        recording.wheels(1.0 + 0.1 * index, 5000 + 100 * index, 10 + index, 30)
    left, right = recording.build()
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
    good = recording.build()[0].count.tolist()
    recording.wheels(1.0, 2000, 1_000_000, 20)
    (left, _), notes = recording.columns.build()
    assert left.count.tolist() == good
    assert notes == [
        "teensy_wheel: 1 reports of the wheels that make no sense: left out"]
