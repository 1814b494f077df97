"""The time scale of a recording never runs back, whatever the computer's clock did."""
from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.units import NS_PER_S
from car_interface.tools.recordings.timeline import BREAK_S, Timeline

START_NS = 1_700_000_000 * NS_PER_S


def test_times_count_from_the_first_message_and_a_small_step_back_is_no_set_clock():
    timeline = Timeline()
    times_s = [0.0, 0.5, 2.0, 1.5]
    assert [timeline.recorded_s(START_NS + round(t * NS_PER_S)) for t in times_s] == times_s
    assert (timeline.start_ns, timeline.last_s, timeline.notes()) == (START_NS, 2.0, ())
    assert timeline.stamped_s(START_NS + NS_PER_S) == 1.0


def test_clock_that_was_set_back_begins_another_drive_behind_the_first_and_is_noted():
    timeline = Timeline()
    for t in (0.0, 100.0):
        timeline.recorded_s(START_NS + round(t * NS_PER_S))
    assert timeline.recorded_s(START_NS + 40 * NS_PER_S) == pytest.approx(100.0 + BREAK_S)
    assert timeline.recorded_s(START_NS + 41 * NS_PER_S) == pytest.approx(101.0 + BREAK_S)
    assert timeline.stamped_s(START_NS + 40 * NS_PER_S) == pytest.approx(100.0 + BREAK_S)
    (note,) = timeline.notes()
    assert note.startswith("the computer's clock was set back by 60.0 s, 100.0 s after the start: ")


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=30))
def test_newest_time_never_falls(times_ms):
    timeline, last_s = Timeline(), 0.0
    for time_ms in times_ms:
        timeline.recorded_s(START_NS + time_ms * 1_000_000)
        assert timeline.last_s >= last_s
        last_s = timeline.last_s
