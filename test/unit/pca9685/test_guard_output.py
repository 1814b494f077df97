"""What a guard reads back is published on change, and once a second, but never without a new reading."""

import pytest

from car_interface.pca9685.guard_output import MAX_PENDING, OutputReadings

MS = 1_000_000
SAFE = (319, 307) + (0,) * 14
OFF = (0,) * 16
FULL_ON = (319, 4096) + (0,) * 14
SAFE_DUTIES, OFF_DUTIES = [5104, 4912] + [0] * 14, [0] * 16


@pytest.fixture
def readings():
    return OutputReadings()


def published(readings, *given):
    """What is published of readings, given as (ms, counts), and when."""
    found = []
    for at_ms, counts in given:
        readings.update(counts, at_ms * MS)
        found += [(at_ms, duties) for duties in readings.pending]
        readings.pending.clear()
    return found


def test_readings_are_published_as_duties_on_change(readings):
    assert published(readings, (0, SAFE), (50, SAFE), (100, OFF), (150, OFF), (200, FULL_ON)) == [
        (0, SAFE_DUTIES), (100, OFF_DUTIES), (200, [5104, 65535] + [0] * 14)]


def test_reading_that_stays_the_same_is_repeated_ten_times_a_second_but_not_without_a_reading(readings):
    at_ms = [0, 99, *range(100, 401, 50), 5000, 5050]
    assert [ms for ms, _ in published(readings, *((ms, SAFE) for ms in at_ms))] == [0, 100, 200, 300, 400, 5000]


def test_readings_that_wait_for_the_master_are_kept_in_order_and_repetitions_are_not(readings):
    for at_ms in range(0, 5000, 50):
        readings.update(SAFE, at_ms * MS)
    readings.update(OFF, 5000 * MS)
    assert readings.pending == [SAFE_DUTIES, OFF_DUTIES]


def test_readings_that_wait_are_limited_to_the_newest(readings):
    for index in range(3 * MAX_PENDING):
        readings.update((SAFE, OFF)[index % 2], index)
    assert readings.pending == [SAFE_DUTIES, OFF_DUTIES] * (MAX_PENDING // 2)
