"""Curves, paths and places of any length are kept in bounded memory."""
import cmath
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from car_interface.tools.report.downsample import Path, Spots, Trace


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(-5, 5)), min_size=1, max_size=300), st.integers(1, 20))
def test_trace_keeps_every_extreme_and_invents_nothing(samples, bins):
    trace = Trace(10.0, bins)
    for time_s, value in samples:
        trace.add(time_s, value)
    times, values = trace.curve(gap_s=100)
    kept = {(time_s, value) for time_s, value in zip(times, values)}
    assert kept <= set(samples) and len(times) <= 2 * bins and (np.diff(times) >= 0).all()
    assert (values.min(), values.max()) == (min(value for _, value in samples), max(value for _, value in samples))
    assert (trace.minimum, trace.maximum, trace.count) == (values.min(), values.max(), len(samples))


def test_trace_breaks_where_nothing_came():
    trace = Trace(100.0)
    for time_s in (0, 0.5, 1, 50, 50.5):
        trace.add(time_s, 1.0)
    _, values = trace.curve()
    (gap,) = np.flatnonzero(np.isnan(values))
    assert 0 < gap < len(values) - 1


def test_path_of_any_length_keeps_few_points_and_its_shape():
    path = Path(step_m=0.01, max_points=500)
    for step in range(100_000):
        path.add(complex(math.cos(step / 1000) * (1 + step / 1e5), math.sin(step / 1000)), 3)
    assert 200 < len(path.places) <= 500 and max(place.real for place in path.places) > 1.9


def test_path_that_is_interrupted_stays_so_however_often_it_is_thinned():
    path = Path(step_m=0.01, max_points=100)
    for step in range(1000):
        path.add(step / 50 + 0j, 3)
        if step == 33:
            path.interrupt()
    gaps = [place for place in path.places if cmath.isnan(place)]
    assert len(gaps) == 1 and math.isnan(gaps[0].real) and math.isnan(gaps[0].imag) and len(path.places) <= 100


def test_path_keeps_each_change_of_driver():
    path = Path()
    for step, kind in enumerate((1, 1, 3, 3, 4)):
        path.add(step / 1e4 + 0j, kind)
    assert path.kinds == [1, 3, 4]


def test_spots_without_end_keep_few_cells_within_half_of_their_width():
    spots = Spots(cell_m=0.01, max_cells=300)
    random = np.random.default_rng(1)
    for x_m, y_m in random.uniform(-3, 3, size=(5000, 2)):
        spots.add(complex(x_m, y_m))
    places = spots.places()
    assert len(places) <= 300 and spots.count == 5000 and np.abs(places.real).max() <= 3 + spots.cell_m
