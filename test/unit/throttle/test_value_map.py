"""The value map: looking values up and back, and the files that are refused."""
from __future__ import annotations

import contextlib
import math
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.throttle.value_map import ValueMap, load_value_map

SHIPPED = Path(__file__).resolve().parents[3] / "config" / "value_map.csv"


# --- an independent, naive map, in two steps as the original's documents describe them

def naive_row_accelerations(velocities, rows, velocity):
    """Step 1: each row's acceleration at a velocity, which is clamped to the map; one row after the other."""
    velocity = min(max(velocity, velocities[0]), velocities[-1])
    accelerations = []
    for row in rows:
        for v0, v1, a0, a1 in zip(velocities, velocities[1:], row, row[1:]):
            if v0 <= velocity <= v1:
                accelerations.append(a0 + (a1 - a0) * (velocity - v0) / (v1 - v0))
                break
    return accelerations


def naive_value_at(values, velocities, rows, acceleration, velocity):
    """Step 2: the value whose acceleration that is; the first or the last one beyond them."""
    accelerations = naive_row_accelerations(velocities, rows, velocity)
    if acceleration <= accelerations[0]:
        return values[0]
    for v0, v1, a0, a1 in zip(values, values[1:], accelerations, accelerations[1:]):
        if a0 < acceleration <= a1:
            return v0 + (v1 - v0) * (acceleration - a0) / (a1 - a0)
    return values[-1]


# --- lookup

VALUES = [-2.0, 0.0, 1.0, 3.0]
VELOCITIES = [0.0, 5.0, 10.0]
ROWS = [
    [-4.0, -5.0, -6.0],
    [0.0, -0.5, -1.0],
    [1.0, 0.5, 0.0],
    [5.0, 3.5, 2.0],
]


@pytest.fixture
def value_map():
    return ValueMap(VALUES, VELOCITIES, ROWS)


@pytest.mark.parametrize("acceleration, velocity, value", [
    pytest.param(-4.0, 0.0, -2.0, id="first_corner"),
    pytest.param(5.0, 0.0, 3.0, id="another_corner"),
    pytest.param(-6.0, 10.0, -2.0, id="the_corner_across"),
    pytest.param(2.0, 10.0, 3.0, id="last_corner"),
    pytest.param(-0.5, 5.0, 0.0, id="point_of_the_grid"),
    pytest.param(3.0, 0.0, 2.0, id="between_rows"),
    pytest.param(0.25, 2.5, 0.5, id="between_rows_and_columns"),  # rows at 2.5 m/s: -4.5 -0.25 0.75 4.25
    pytest.param(2.5, 2.5, 2.0, id="between_the_last_rows_and_the_first_columns"),
    pytest.param(-10.0, 3.0, -2.0, id="acceleration_below_the_map_gives_the_first_value"),
    pytest.param(10.0, 3.0, 3.0, id="acceleration_above_the_map_gives_the_last_value"),
    pytest.param(-math.inf, 3.0, -2.0, id="acceleration_infinitely_below"),
    pytest.param(math.inf, 3.0, 3.0, id="acceleration_infinitely_above"),
    pytest.param(3.0, -7.0, 2.0, id="velocity_below_the_map_is_clamped"),
    pytest.param(1.0, 99.0, 2.0, id="velocity_above_the_map_is_clamped"),
    pytest.param(1.0, math.inf, 2.0, id="velocity_infinitely_above_is_clamped"),
])
def test_value_at_acceleration_and_velocity(value_map, acceleration, velocity, value):
    assert value_map.value_at(acceleration, velocity) == pytest.approx(value)
    assert naive_value_at(VALUES, VELOCITIES, ROWS, acceleration, min(velocity, 1e9)) == pytest.approx(value)


@pytest.mark.parametrize("value, velocity, acceleration", [
    pytest.param(-2.0, 0.0, -4.0, id="first_corner"),
    pytest.param(3.0, 10.0, 2.0, id="last_corner"),
    pytest.param(0.5, 2.5, 0.25, id="between_rows_and_columns"),
    pytest.param(-9.0, 5.0, -5.0, id="value_below_the_map_is_clamped"),
    pytest.param(9.0, 5.0, 3.5, id="value_above_the_map_is_clamped"),
    pytest.param(1.0, -1.0, 1.0, id="velocity_below_the_map_is_clamped"),
    pytest.param(1.0, 11.0, 0.0, id="velocity_above_the_map_is_clamped"),
])
def test_acceleration_at_value_and_velocity(value_map, value, velocity, acceleration):
    assert value_map.acceleration_at(value, velocity) == pytest.approx(acceleration)


GAPS = st.floats(0.01, 10)


@st.composite
def rising_axes(draw, start, min_size):
    axis = [draw(start)]
    for gap in draw(st.lists(GAPS, min_size=min_size - 1, max_size=9)):
        axis.append(axis[-1] + gap)
    return axis


@st.composite
def maps(draw):
    """Axes and rows of any map in which acceleration rises with value at every velocity."""
    start = st.floats(-20, 20)
    values = draw(rising_axes(start, 2))
    velocities = draw(rising_axes(start, 2))
    columns = []
    for _ in velocities:
        column = [draw(start)]
        for gap in draw(st.lists(GAPS, min_size=len(values) - 1, max_size=len(values) - 1)):
            column.append(column[-1] + gap)
        columns.append(column)
    return values, velocities, [list(row) for row in zip(*columns)]


@pytest.mark.once
@given(maps(), st.floats(-120, 120), st.floats(-120, 120))
def test_value_in_any_map_equals_the_naive_lookup_s(case, acceleration, velocity):
    values, velocities, rows = case
    expected = naive_value_at(values, velocities, rows, acceleration, velocity)
    assert ValueMap(values, velocities, rows).value_at(acceleration, velocity) == pytest.approx(expected, abs=1e-6)


@pytest.mark.once
@given(maps(), st.data())
def test_value_in_any_map_at_its_own_points_equals_the_row_s(case, data):
    values, velocities, rows = case
    row = data.draw(st.integers(0, len(values) - 1))
    column = data.draw(st.integers(0, len(velocities) - 1))
    assert ValueMap(values, velocities, rows).value_at(rows[row][column], velocities[column]) == values[row]


@pytest.mark.once
@given(maps(), st.floats(-120, 120), st.floats(-120, 120))
def test_forward_of_inverse_is_the_acceleration_as_far_as_the_map_reaches(case, acceleration, velocity):
    values, velocities, rows = case
    value_map = ValueMap(values, velocities, rows)
    reachable = naive_row_accelerations(velocities, rows, velocity)
    expected = min(max(acceleration, reachable[0]), reachable[-1])
    assert value_map.acceleration_at(value_map.value_at(acceleration, velocity), velocity) == pytest.approx(
        expected, abs=1e-6)


@pytest.mark.once
@given(maps(), st.floats(0, 1), st.floats(-120, 120))
def test_inverse_of_forward_is_the_value(case, part, velocity):
    values, velocities, rows = case
    value_map = ValueMap(values, velocities, rows)
    value = values[0] + part * (values[-1] - values[0])
    assert value_map.value_at(value_map.acceleration_at(value, velocity), velocity) == pytest.approx(value, abs=1e-6)


@pytest.mark.once
@given(maps(), st.floats(-120, 120), st.floats(-120, 120), st.floats(-120, 120))
def test_greater_acceleration_never_gets_a_lesser_value(case, one, other, velocity):
    value_map = ValueMap(*case)
    low, high = sorted((one, other))
    assert value_map.value_at(low, velocity) <= value_map.value_at(high, velocity) + 1e-9


NEARLY_LEVEL = st.sampled_from([0.0, 5e-324, 1.0 - 2 ** -53, 1.0, 1.0 + 2 ** -52, 2.0, -1.0])


@pytest.mark.once
@given(st.data())
def test_lookup_in_a_map_all_but_level_never_fails_nor_leaves_the_map(data):
    rows = data.draw(st.integers(2, 4))
    columns = data.draw(st.integers(2, 3))
    table = [sorted(data.draw(st.lists(NEARLY_LEVEL, min_size=rows, max_size=rows))) for _ in range(columns)]
    values, velocities = [float(row) for row in range(rows)], [float(column) for column in range(columns)]
    value_map = ValueMap(values, velocities, list(zip(*table)), allow_plateaus=True)
    velocity = data.draw(st.floats(-1, 3) | st.sampled_from([5e-324, 1.0 - 2 ** -53]))
    assert 0 <= value_map.value_at(data.draw(NEARLY_LEVEL | st.floats(-3, 3)), velocity) <= rows - 1


@pytest.mark.parametrize("values, velocities, low, high, acceleration, velocity", [
    pytest.param([-3.0, -2.0, -1.9999999999999998, -1.0], [-0.9999999999999999, 3.0000000000000004],
                 [1e-323, 0.0007312216794230751, 2.0000000000000004, 3.0],
                 [-3.0000000000000004, -3.0, -5e-324, 1.5e-323], 1e-323, 3.0, id="neighbours_that_a_blend_makes_level"),
    pytest.param([-3.0, -1.0, 0.000644116475764579, 1.9999999999999998], [-0.9999999999999998, 0.0],
                 [-2.0000000000000004, -1.4545737719662633, 0.0, 1.9999999999999996],
                 [0.9999999999999998, 0.9999999999999999, 1.0, 1.9999999999999998], 0.9999999999999999, -5e-324,
                 id="an_acceleration_between_them"),
])
def test_lookup_where_rounding_levels_neighbours_does_not_divide_by_their_difference(values, velocities, low, high,
                                                                                   acceleration, velocity):
    value = ValueMap(values, velocities, list(zip(low, high))).value_at(acceleration, velocity)
    assert values[0] <= value <= values[-1]


# --- large maps, which are kept in another way

def test_large_map_looks_up_as_a_small_one_does():
    size = 400
    values, velocities = [0.1 * row for row in range(size)], [0.05 * column for column in range(size)]
    rows = [[value ** 1.5 - 0.3 * velocity - 0.002 * velocity ** 2 for velocity in velocities] for value in values]
    large = ValueMap(values, velocities, rows)
    for acceleration, velocity in ((0.0, 0.0), (17.3, 3.14), (-2.0, 11.111), (100.0, 19.95), (999.0, 7.0), (3.0, 99.0)):
        assert large.value_at(acceleration, velocity) == pytest.approx(
            naive_value_at(values, velocities, rows, acceleration, velocity))


# --- plateaus

PLATEAU_ROWS = [
    [-1.0, -1.0],
    [0.0, -0.5],
    [0.0, 0.0],
    [0.0, 0.5],
    [2.0, 2.0],
]


@pytest.mark.parametrize("values, value", [
    pytest.param([-2.0, -1.0, 0.0, 1.0, 2.0], 0.0, id="of_a_plateau_around_zero_that_is_zero"),
    pytest.param([1.0, 2.0, 3.0, 4.0, 5.0], 2.0, id="of_a_plateau_above_zero_that_is_its_first"),
    pytest.param([-5.0, -4.0, -3.0, -2.0, -1.0], -2.0, id="of_a_plateau_below_zero_that_is_its_last"),
    pytest.param([-3.0, -1.5, 0.5, 0.75, 2.0], 0.0, id="of_one_that_spans_zero_between_rows_that_is_zero"),
])
def test_plateau_gives_its_value_of_least_magnitude(values, value):
    value_map = ValueMap(values, [0.0, 10.0], PLATEAU_ROWS, allow_plateaus=True)
    assert value_map.value_at(0.0, 0.0) == value


@pytest.mark.parametrize("velocity", [0.0, 2.5, 10.0])
@pytest.mark.parametrize("values, value", [([-2.0, -1.0, 1.0, 2.0, 3.0], 0.0), ([1.0, 2.0, 3.0, 4.0, 5.0], 2.0),
                                           ([-5.0, -4.0, -3.0, -2.0, -1.0], -2.0)])
def test_plateau_at_every_velocity_gives_its_value_of_least_magnitude_between_columns_too(values, value, velocity):
    rows = [[-1.0, -3.0], [0.5, -1.5], [0.5, -1.5], [0.5, -1.5], [2.0, 2.0]]
    value_map = ValueMap(values, [0.0, 10.0], rows, allow_plateaus=True)
    assert value_map.value_at(0.5 - 0.2 * velocity, velocity) == value


def test_plateau_s_sides_are_interpolated_as_ever():
    value_map = ValueMap([1.0, 2.0, 3.0, 4.0, 5.0], [0.0, 10.0], PLATEAU_ROWS, allow_plateaus=True)
    assert value_map.value_at(-0.5, 0.0) == pytest.approx(1.5)
    assert value_map.value_at(1.0, 0.0) == pytest.approx(4.5)
    assert value_map.value_at(0.25, 10.0) == pytest.approx(3.5)


@pytest.mark.parametrize("rows, acceleration, value", [
    pytest.param([[0, 0], [0, 0], [1, 1]], 0.0, 1.0, id="at_the_lower_end"),
    pytest.param([[0, 0], [0, 0], [1, 1]], -0.1, 1.0, id="below_the_lower_end"),
    pytest.param([[0, 0], [1, 1], [1, 1]], 1.0, 2.0, id="at_the_upper_end"),
    pytest.param([[0, 0], [1, 1], [1, 1]], 1.1, 3.0, id="above_the_upper_end"),
    pytest.param([[1, 1], [1, 1], [1, 1]], 1.0, 1.0, id="of_a_map_that_is_one"),
])
def test_plateau_at_an_end_of_the_map(rows, acceleration, value):
    assert ValueMap([1.0, 2.0, 3.0], [0.0, 1.0], rows, allow_plateaus=True).value_at(acceleration, 0.5) == value


# --- what is refused

@pytest.mark.parametrize("values, velocities, rows, message", [
    pytest.param([1], [0, 1], [[1, 2]], "map, values is .1.; accepted: at least two", id="one_value"),
    pytest.param([1, 1], [0, 1], [[1, 2], [3, 4]], r"map, values\[1\] is 1; accepted: more than", id="level_values"),
    pytest.param([1, 2], [0], [[1], [2]], "map, velocities is .0.; accepted: at least two", id="one_velocity"),
    pytest.param([1, 2], [1, 0], [[1, 2], [3, 4]], r"map, velocities\[1\] is 0; accepted: more than",
                 id="falling_velocities"),
    pytest.param([1, 2], [0, math.nan], [[1, 2], [3, 4]], r"map, velocities\[1\] is nan", id="velocity_nan"),
    pytest.param([1, 2], [0, 1], [[1, 2]], "map, rows is 1; accepted: 2, one for each value", id="row_missing"),
    pytest.param([1, 2], [0, 1], [[1, 2], [3]], "map, row of value 2 is .3.; accepted: 2 finite accelerations",
                 id="row_too_short"),
    pytest.param([1, 2], [0, 1], [[1, 2], [3, math.inf]], "map, row of value 2 is .3, inf.; accepted: 2 finite",
                 id="acceleration_infinite"),
    pytest.param([1, 2], [0, 1], [[1, 2], [3, 2]],
                 "map, at velocity 1 m/s, from value 1 to 2 stays level at 2.0 m/s²; accepted: an acceleration "
                 r"that rises with value \(allow_plateaus: true takes level stretches\)", id="level_stretch"),
    pytest.param([1, 2, 3], [0, 1], [[1, 2], [3, 4], [2, 5]],
                 "map, at velocity 0 m/s, from value 2 to 3 falls from 3.0 to 2.0 m/s²; accepted: an acceleration "
                 "that rises with value$", id="falling_stretch"),
])
def test_map_with_a_fault_is_refused_naming_it(values, velocities, rows, message):
    with pytest.raises(ConfigError, match=message):
        ValueMap(values, velocities, rows, name="map")


def test_falling_stretch_is_refused_with_plateaus_allowed_too():
    with pytest.raises(ConfigError, match=r"from value 1 to 2 falls from 3.0 to 2.0 m/s²"):
        ValueMap([1, 2], [0, 1], [[3, 1], [2, 2]], allow_plateaus=True)


# --- files

GOOD = "default,0.0,5.0,10.0\n-2.0,-4.0,-5.0,-6.0\n0.0,0.0,-0.5,-1.0\n1.0,1.0,0.5,0.0\n3.0,5.0,3.5,2.0\n"


def written(tmp_path, content):
    path = tmp_path / "value_map.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return str(path)


@pytest.mark.parametrize("content", [
    pytest.param(GOOD, id="as_it_should_be"),
    pytest.param(GOOD.replace("\n", "\r\n"), id="with_crlf"),
    pytest.param(b"\xef\xbb\xbf" + GOOD.encode(), id="with_a_byte_order_mark"),
    pytest.param(GOOD.replace(",", " ,\t "), id="with_spaces_around_its_numbers"),
    pytest.param(GOOD + "\n", id="with_a_blank_line_at_the_end"),
    pytest.param(GOOD + "\n \n\r\n", id="with_several_blank_lines_at_the_end"),
    pytest.param(GOOD.rstrip("\n"), id="without_a_newline_at_the_end"),
    pytest.param(GOOD.replace("default", ""), id="without_a_name"),
    pytest.param(GOOD.replace("default", "Wägelchen"), id="with_a_name_beyond_ascii"),
    pytest.param(GOOD.replace("-2.0,", "-2e0,").replace("10.0", "10"), id="with_exponents_and_integers"),
])
def test_file_is_loaded(tmp_path, content):
    value_map = load_value_map(written(tmp_path, content))
    assert value_map.values == tuple(VALUES)
    assert value_map.velocities == tuple(VELOCITIES)
    assert [[value_map.acceleration_at(value, velocity) for velocity in VELOCITIES] for value in VALUES] == ROWS


@pytest.mark.parametrize("content, message", [
    pytest.param("", r"value_map.csv has 0 line\(s\); accepted: a line of velocities and at least two", id="empty"),
    pytest.param("\n\n", r"has 0 line\(s\)", id="blank"),
    pytest.param("default,0,1\n", r"has 1 line\(s\)", id="velocities_only"),
    pytest.param("default,0,1\n1,2,3\n", r"has 2 line\(s\)", id="one_row"),
    pytest.param("default,0\n1,2\n2,3\n", r"line 1 is \['default', '0'\]; accepted: a name and at least two velocities",
                 id="one_column"),
    pytest.param("default\n1\n2\n", r"line 1 is \['default'\]; accepted: a name", id="no_column"),
    pytest.param("default,0,1\n1,2,3\n2,3\n", "line 3 has 2 columns; accepted: 3, as in line 1", id="row_too_short"),
    pytest.param("default,0,1\n1,2,3,4\n2,3,4\n", "line 2 has 4 columns; accepted: 3, as in line 1",
                 id="row_too_long"),
    pytest.param("default,0,1\n1,2,3\n\n2,3,4\n", "line 3 is blank; accepted: numbers; a blank line may only come last",
                 id="blank_line_in_between"),
    pytest.param("\ndefault,0,1\n1,2,3\n2,3,4\n", "line 1 is blank; accepted: numbers; a blank",
                 id="blank_line_first"),
    pytest.param("default,0,one\n1,2,3\n2,3,4\n", "line 1, column 3 is 'one'; accepted: a finite number",
                 id="velocity_that_is_no_number"),
    pytest.param("default,0,1\n1,2,3\n2,x,4\n", "line 3, column 2 is 'x'; accepted: a finite number",
                 id="acceleration_that_is_no_number"),
    pytest.param("default,0,1\none,2,3\n2,3,4\n", "line 2, column 1 is 'one'; accepted: a finite number",
                 id="value_that_is_no_number"),
    pytest.param("default,0,1\n1,,3\n2,3,4\n", "line 2, column 2 is ''; accepted: a finite number", id="empty_cell"),
    pytest.param("default,0,1\n1,nan,3\n2,3,4\n", "line 2, column 2 is 'nan'; accepted: a finite number", id="nan"),
    pytest.param("default,0,1\n1,2,3\n2,3,inf\n", "line 3, column 3 is 'inf'; accepted: a finite number",
                 id="infinity"),
    pytest.param("default,0,1\n1,2,3\n2,3,1e999\n", "line 3, column 3 is '1e999'", id="number_too_great"),
    pytest.param("default,0,1\n1,2,3\n2,3,1_0\n", "line 3, column 3 is '1_0'; accepted: a finite number",
                 id="number_with_an_underscore"),
    pytest.param("default,0,1\n1,2,3\n2,3,١٢\n", "line 3, column 3 is '١٢'; accepted: a finite number",
                 id="arabic_digits"),
    pytest.param("default,0,७\n1,2,3\n2,3,4\n", "line 1, column 3 is '७'; accepted: a finite number",
                 id="hindi_digits"),
    pytest.param("default,1,1\n1,2,3\n2,3,4\n", "line 1, column 3 is 1.0; accepted: more than the one before it, 1.0",
                 id="level_velocities"),
    pytest.param("default,1,0\n1,2,3\n2,3,4\n", "line 1, column 3 is 0.0; accepted: more than the one before it, 1.0",
                 id="falling_velocities"),
    pytest.param("default,0,1\n1,2,3\n1,3,4\n", "line 3, column 1 is 1.0; accepted: more than the one before it, 1.0",
                 id="level_values"),
    pytest.param("default,0,1\n2,2,3\n1,3,4\n", "line 3, column 1 is 1.0; accepted: more than the one before it, 2.0",
                 id="falling_values"),
    pytest.param("default,0,1\n1,2,3\n2,2,4\n", "at velocity 0.0 m/s, from value 1.0 to 2.0 stays level at 2.0",
                 id="level_stretch"),
    pytest.param("default,0,1\n1,2,3\n2,3,2\n", "at velocity 1.0 m/s, from value 1.0 to 2.0 falls from 3.0 to 2.0",
                 id="falling_stretch"),
    pytest.param(b"default,0,1\n1,2,3\n2,3,\xe9\n", r"csv_path_value_map is .*; accepted: a CSV file in UTF-8 \(",
                 id="not_in_utf_8"),
    pytest.param(GOOD.encode("utf-16"), r"csv_path_value_map is .*; accepted: a CSV file in UTF-8 \(", id="in_utf_16"),
    pytest.param("default,0," + "1" * 200_000 + "\n1,2,3\n2,3,4\n", r"accepted: a CSV file in UTF-8 \(field larger",
                 id="cell_longer_than_csv_takes"),
    pytest.param("default;0;1\n1;2;3\n2;3;4\n", r"line 1 is \['default;0;1'\]; accepted: a name and at least two",
                 id="semicolons"),
    pytest.param(b"default,0,1\n1,2,3\n2,3,\x00\n", r"line 3, column 3|a CSV file in UTF-8", id="a_nul"),
])
def test_file_with_a_fault_is_refused_naming_file_line_and_column(tmp_path, monkeypatch, content, message):
    monkeypatch.chdir(tmp_path)  # a message cuts a long path
    with pytest.raises(ConfigError, match=message) as caught:
        load_value_map(os.path.basename(written(tmp_path, content)))
    assert "value_map" in caught.value.name
    assert "value_map.csv" in str(caught.value)


def test_file_with_a_level_stretch_is_loaded_when_plateaus_are_allowed(tmp_path):
    path = written(tmp_path, "default,0,1\n1,2,3\n2,2,4\n")
    assert load_value_map(path, allow_plateaus=True).value_at(2.0, 0.0) == 1.0


@pytest.mark.parametrize("name, reason", [("missing.csv", "No such file or directory"), ("", "Is a directory")],
                         ids=["file_that_is_missing", "directory"])
def test_file_that_cannot_be_read_is_refused_naming_parameter_path_and_reason(tmp_path, name, reason):
    with pytest.raises(ConfigError, match=rf"csv_path_value_map is .*; accepted: a file that can be read \({reason}\)"):
        load_value_map(str(tmp_path / name))


@pytest.mark.parametrize("make, reason", [
    pytest.param(lambda path: os.mkfifo(str(path)), "it is a pipe", id="pipe"),
    pytest.param(lambda path: path.symlink_to("/dev/zero"), "it is a device", id="device"),
    pytest.param(lambda path: (path.touch(), os.truncate(str(path), 10_000_001)), "it has 10.0 MB, more than 10 MB",
                 id="sparse_file"),
])
def test_what_is_no_map_by_kind_or_size_is_refused(tmp_path, make, reason):
    path = tmp_path / "value_map.csv"
    make(path)
    with pytest.raises(ConfigError, match=rf"csv_path_value_map is .*; accepted: a file that can be read \({reason}\)"):
        load_value_map(str(path))


def test_text_that_will_be_a_file_is_checked_before_there_is_one(tmp_path):
    path = str(tmp_path / "value_map.csv")
    assert load_value_map(path, text=GOOD).values == tuple(VALUES)
    with pytest.raises(ConfigError, match=rf"^{path} has 1 line\(s\)"):
        load_value_map(path, text="default,0,1\n")
    assert os.listdir(str(tmp_path)) == []


@pytest.mark.once
@pytest.mark.parametrize("content", [
    pytest.param(SHIPPED.read_bytes(), id="shipped"),
    pytest.param(b"\xef\xbb\xbf" + GOOD.replace("default", "Wägelchen").replace("\n", "\r\n").encode(),
                 id="crlf_byte_order_mark_and_a_name_beyond_ascii"),
])
def test_file_cut_at_any_byte_is_loaded_or_refused_and_nothing_else(tmp_path, content):
    loaded = 0
    for length in range(len(content)):
        path = written(tmp_path, content[:length])
        try:
            value_map = load_value_map(path)
        except ConfigError as inhibit:
            assert "value_map" in inhibit.name
        else:
            loaded += 1
            assert len(value_map.values) >= 2
    assert 0 < loaded < len(content)


@given(st.integers(0, len(GOOD) - 1), st.binary(max_size=2) | st.sampled_from([b",", b"\n", b"\r", b'"', b"-", b"e"]))
def test_file_with_any_byte_replaced_is_loaded_or_refused_and_nothing_else(tmp_path_factory, place, instead):
    content = GOOD.encode()
    path = written(tmp_path_factory.getbasetemp(), content[:place] + instead + content[place + 1:])
    with contextlib.suppress(ConfigError):
        load_value_map(path)


def test_shipped_map_covers_the_shipped_limits_and_brakes_at_every_velocity():
    value_map = load_value_map(str(SHIPPED))
    assert (value_map.values[0], value_map.values[-1]) == (-5.0, 3.0)
    assert value_map.velocities[0] == 0.0
    for velocity in value_map.velocities:
        assert value_map.value_at(0.0, velocity) >= 0.0
        assert value_map.value_at(-3.0, velocity) < 0.0
