"""Whatever comes in from outside ends as a value, a count or an error of this package; never as anything else.

The serial line's cases are pieces of the golden capture, damaged, and read in pieces of random sizes: a million with
CAR_INTERFACE_ALL. Parameters and the nodes' callbacks are fuzzed in test/graph/test_fuzz.py.
"""
import csv
import io
import math
import os
import random
import tempfile
from itertools import product

import pytest
from damage import damaged
from hypothesis import example, given, settings
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.teensy.link import protocol
from car_interface.teensy.link.framing import MAX_ON_LINE, FrameDecoder
from car_interface.teensy.sensing.plausibility import Gates
from car_interface.throttle.value_map import load_value_map
from teensy_bench import CAPTURE, framed_by_the_textbook

MARKER = bytes.fromhex("7e 01020600 006b11057b0000 f9 7e")  # from the capture: a sonar's report
CASES = 1_000_000 if os.environ.get("CAR_INTERFACE_ALL") else 2000


def test_line_fed_cases_made_of_the_capture_stays_in_order():
    decoder, at_once, gates, seen = FrameDecoder(), FrameDecoder(), Gates(), set()
    judges = {protocol.WheelStatus: gates.wheels, protocol.SonarStatus: gates.sonar,
              protocol.Pong: lambda pong: gates.pong(pong, is_ours=True)}

    def judge(bodies):
        for record in map(protocol.decode, bodies):
            seen.add(type(record))
            if isinstance(record, protocol.Malformed):
                assert record.reason
            judges.get(type(record), str)(record)

    def on_line(data, bodies):
        return data.count(b"\x7e") + sum(len(framed_by_the_textbook(body)) - 2 for body in bodies)

    accounted = 0  # bytes of frames and flags
    for number in range(CASES):
        choose = random.Random(7 * 1_000_003 + number)
        begin, size = choose.randrange(len(CAPTURE)), choose.choice((1, 3, 7, 64, 4096))
        data = damaged(CAPTURE[begin:begin + choose.choice((1, 5, 20, 40, 80, 200))], choose)
        found = [body for start in range(0, len(data), size) for body in decoder.feed(data[start:start + size])]
        judge(found)
        assert found == at_once.feed(data) and decoder.tally == at_once.tally
        accounted += on_line(data, found)
        assert decoder.pending <= MAX_ON_LINE
        assert decoder.tally.bytes_in == accounted + decoder.tally.noise_bytes + decoder.pending
        if choose.random() < 0.02:
            decoder.reset()
            at_once.reset()
        found = decoder.feed(MARKER)
        at_once.feed(MARKER)
        accounted += on_line(MARKER, found)
        judge(found)
        assert found[-1] == MARKER[1:-2], number
    assert seen == {protocol.Pong, protocol.SonarStatus, protocol.WheelStatus, protocol.ErrorCount, protocol.Malformed}


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


def table(rows):
    """Return a CSV file of these cells."""
    text = io.StringIO()
    csv.writer(text, escapechar="\\").writerows([[cell.replace("\0", "") for cell in row] for row in rows])
    return text.getvalue()


@settings(max_examples=400)
@given(st.binary(max_size=200) | (st.text(max_size=200) | st.lists(
    st.lists(CELLS, min_size=1, max_size=5), max_size=6).map(table)).map(
        lambda text: text.encode("utf-8", "surrogatepass")))
@pytest.mark.once
@example(b"")
@example(b"\xff\xfe\x00")
@example(b'"\n\n\n')
@example(b"a,0,1\n0,0,0\r\r1,1,1")
def test_map_of_any_bytes_or_cells_is_loaded_or_refused_with_a_config_error(data):
    found = loaded(data)
    if found is None:
        return
    slack = 1e-9 * max(1.0, *map(abs, found.values))
    for acceleration, velocity in product((-math.inf, -1.0, 0.0, 1e308, math.inf), (-1.0, 0.0, 3.3, 1e308)):
        value = found.value_at(acceleration, velocity)
        assert found.values[0] - slack <= value <= found.values[-1] + slack
