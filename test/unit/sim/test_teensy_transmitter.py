"""The simulated Teensy's transmitter and the line behind it."""

from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.sim.teensy_transmitter import OutgoingLine
from teensy_bench import GET_COUNTERS, MS, Bench, S


@settings(max_examples=25)
@given(st.lists(st.integers(1, 30 * MS), min_size=1, max_size=40), st.sampled_from([9600, 57600, 115200]))
def test_line_never_sends_faster_than_its_baud_rate(spans_ns, baud):
    bench = Bench(lambda sensor, at_ns: 300, baud=baud, sonar_wait_ms=0)
    for span_ns in spans_ns:
        before = len(bench.sent)
        bench.after(span_ns).command(GET_COUNTERS)
        # Of the byte that is on the wire at the start of the span all but the last bit may be out already.
        assert len(bench.sent) - before <= span_ns * baud / (10 * S) + 1


def test_line_asked_more_often_sends_the_same_bytes():
    seldom, often = (Bench(lambda sensor, at_ns: 700 * sensor, sonar_wait_ms=0) for _ in range(2))
    for at_us in range(0, 300_000, 130):
        often.until(at_us * 1000)
    assert often.until(S).sent == seldom.until(S).sent
    assert len(seldom.sent) > 1000


def test_line_cut_loses_only_what_was_not_out():
    line = OutgoingLine(baud=10_000, buffer_size=64)  # a byte each millisecond
    line.write(b"abcdef", 0)
    line.cut(3 * MS)
    line.write(b"xyz", 4 * MS)
    assert line.collect(5 * MS) == b"abcx"
    assert line.collect(10 * MS) == b"yz"
