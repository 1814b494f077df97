"""Lookup tables and rounding: what a table answers, which tables are refused, and which way a half goes."""
import math
from decimal import ROUND_HALF_UP, Decimal
from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.common.lookup_table import LookupTable, check_axis, round_half_away

AXIS = [1.0, 2.0, 4.0, 8.0]
VALUES = [10.0, 30.0, 20.0, 20.0]


@pytest.mark.parametrize("x, y", [
    (1.0, 10.0), (2.0, 30.0), (8.0, 20.0), (1.25, 15.0), (3.0, 25.0), (5.0, 20.0), (0.999, 10.0), (8.001, 20.0),
    (-math.inf, 10.0), (math.inf, 20.0)])
def test_lookup_is_interpolated_between_breakpoints_and_saturates_beyond(x, y):
    assert LookupTable(AXIS, VALUES)(x) == pytest.approx(y)


def test_table_of_integers_answers_in_floating_point_and_as_before_after_its_lists_were_changed():
    axis, values = [0, 10], [0, 1]
    table = LookupTable(axis, values)
    axis[1], values[1] = 100.0, -1.0
    assert table(5) == 0.5


@st.composite
def tables_and_points(draw):
    axis = sorted(draw(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=12, unique=True)))
    values = draw(st.lists(st.floats(-1e6, 1e6), min_size=len(axis), max_size=len(axis)))
    return axis, values, draw(st.floats(-2e6, 2e6) | st.sampled_from(axis))


def exact_lookup(axis, values, x):
    """The definition of a table in exact arithmetic, by walking along it."""
    axis, values, x = [Fraction(a) for a in axis], [Fraction(v) for v in values], Fraction(x)
    if x <= axis[0]:
        return values[0]
    for x0, x1, y0, y1 in zip(axis, axis[1:], values, values[1:]):
        if x <= x1:
            return y0 + (x - x0) * (y1 - y0) / (x1 - x0)
    return values[-1]


@pytest.mark.once
@given(tables_and_points())
def test_lookup_in_any_table_equals_the_exact_definition(case):
    axis, values, x = case
    assert LookupTable(axis, values)(x) == pytest.approx(float(exact_lookup(axis, values, x)), rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("axis, values, message", [
    ([], [], r"radii is \[\]; accepted: at least two increasing numbers"),
    ([1], [1], r"radii is \[1\]; accepted: at least two increasing numbers"),
    ([1, 1], [1, 2], r"radii\[1\] is 1; accepted: more than the element before it, 1"),
    ([1, 3, 2], [1, 2, 3], r"radii\[2\] is 2; accepted: more than the element before it, 3"),
    ([math.nan, 1], [1, 2], r"radii\[0\] is nan; accepted: a finite number"),
    ([1, math.inf], [1, 2], r"radii\[1\] is inf; accepted: a finite number"),
    ([-1e308, 0, 1e308], [1, 2, 3], r"radii is \[-1e\+308, 0, 1e\+308\]; accepted: "),
    ([1, 2, 3], [1, 2], r"duties is \[1, 2\]; accepted: 3 numbers, one for each element of radii"),
    ([1, 2], [1, 2, 3], r"duties is \[1, 2, 3\]; accepted: 2 numbers"),
    ([1, 2], [1, math.nan], r"duties\[1\] is nan; accepted: a finite number"),
    ([1, 2], [-math.inf, 1], r"duties\[0\] is -inf; accepted: a finite number"),
])
def test_table_with_a_fault_is_refused_naming_the_element(axis, values, message):
    with pytest.raises(ConfigError, match=message):
        LookupTable(axis, values, "radii", "duties")


def test_axis_that_rises_by_the_least_possible_or_whose_ends_cancel_out_is_accepted():
    check_axis([1.0, 1.0000000000000002], "axis")
    check_axis([1e308, 1.1e308], "axis")


@pytest.mark.parametrize("x, rounded", [
    (0.5, 1), (-0.5, -1), (2.5, 3), (-2.5, -3), (5099.499, 5099), (0.49999999999999994, 0),
    (4503599627370497.0, 4503599627370497), (-0.0, 0)])
def test_rounding_of_a_half_goes_away_from_zero(x, rounded):
    result = round_half_away(x)
    assert result == rounded and isinstance(result, int)


@pytest.mark.once
@given(st.floats(-1e17, 1e17) | st.integers(-10 ** 6, 10 ** 6).map(lambda n: n / 2))
@example(0.49999999999999994)
def test_rounding_of_any_number_equals_exact_decimal_rounding(x):
    assert round_half_away(x) == int(Decimal(x).quantize(Decimal(1), rounding=ROUND_HALF_UP))
