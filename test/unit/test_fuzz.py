"""Whatever comes in from outside ends as a value, a count or an error of this package; never as anything else.

The serial line's cases are made by test/fuzz.py from the golden capture; ``python3 test/fuzz.py`` runs a million.
Parameters and the nodes' callbacks are fuzzed in test/graph/test_fuzz.py, where there is ROS.
"""
from __future__ import annotations

import csv
import io
import math
import os
import tempfile

import fuzz
from hypothesis import example, given, settings
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.teensy.link import protocol
from car_interface.throttle.value_map import ValueMap, load_value_map

CASES = 1_000_000 if os.environ.get("CAR_INTERFACE_ALL") else 2000
RECORDS = (protocol.Pong, protocol.SonarStatus, protocol.WheelStatus, protocol.ErrorCount, protocol.Malformed)


def test_line_fed_cases_made_of_the_capture_stays_in_order():
    run = fuzz.Fuzz(seed=7)
    for number in range(CASES):
        run.case(number)
    assert run.cases == CASES
    assert set(run.records) == {record.__name__ for record in RECORDS}


CELLS = st.one_of(
    st.floats(allow_nan=True).map(str), st.integers(-10 ** 30, 10 ** 30).map(str), st.text(max_size=8),
    st.sampled_from(["", " ", "nan", "inf", "-inf", "1e999", "1e-999", "0x10", "1,5", '"', '"1', "1_0", "\ufeff", "#"]))


def loaded(data):
    """The map in a file of these bytes, and None when it was refused as it should be."""
    descriptor, path = tempfile.mkstemp(suffix=".csv")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
        return load_value_map(path)
    except ConfigError as error:
        assert str(error) and "accepted" in str(error)
        return None
    finally:
        os.unlink(path)


def check_map(found):
    assert isinstance(found, ValueMap)
    for acceleration in (-math.inf, -1.0, 0.0, 1e308, math.inf):
        for velocity in (-1.0, 0.0, 3.3, 1e308):
            value = found.value_at(acceleration, velocity)
            slack = 1e-9 * max(1.0, *map(abs, found.values))
            assert found.values[0] - slack <= value <= found.values[-1] + slack


def table(rows):
    """Return a CSV file of these cells."""
    text = io.StringIO()
    csv.writer(text, escapechar="\\").writerows([[cell.replace("\0", "") for cell in row] for row in rows])
    return text.getvalue()


@settings(max_examples=400)
@given(st.binary(max_size=200) | (st.text(max_size=200) | st.lists(
    st.lists(CELLS, min_size=1, max_size=5), max_size=6).map(table)).map(
        lambda text: text.encode("utf-8", "surrogatepass")))
@example(b"")
@example(b"\xff\xfe\x00")
@example(b'"\n\n\n')
@example(b"a,0,1\n0,0,0\r\r1,1,1")
def test_map_of_any_bytes_or_cells_is_loaded_or_refused_with_a_config_error(data):
    found = loaded(data)
    if found is not None:
        check_map(found)
