"""The value map: looking values up and back, and the files that are refused."""

import math
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.throttle.value_map import ValueMap, load_value_map

SHIPPED = Path(__file__).resolve().parents[3] / "config" / "value_map.csv"
VALUES = [-2.0, 0.0, 1.0, 3.0]
VELOCITIES = [0.0, 5.0, 10.0]
ROWS = [[-4.0, -5.0, -6.0], [0.0, -0.5, -1.0], [1.0, 0.5, 0.0], [5.0, 3.5, 2.0]]
GAPS = st.floats(0.01, 10)
NEARLY_LEVEL = st.sampled_from([0.0, 5e-324, 1.0 - 2 ** -53, 1.0, 1.0 + 2 ** -52, 2.0, -1.0])
PLATEAU_ROWS = [[-1.0, -1.0], [0.0, -0.5], [0.0, 0.0], [0.0, 0.5], [2.0, 2.0]]
RISES = "accepted: an acceleration that rises with value"
GOOD = "default,0.0,5.0,10.0\n-2.0,-4.0,-5.0,-6.0\n0.0,0.0,-0.5,-1.0\n1.0,1.0,0.5,0.0\n3.0,5.0,3.5,2.0\n"
NO_UTF_8, NO_NUMBER = r"csv_path_value_map is .*; accepted: a CSV file in UTF-8 \(", "accepted: a finite number"


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


@pytest.mark.parametrize("acceleration, velocity, value", [
    (-4.0, 0.0, -2.0), (2.0, 10.0, 3.0), (-0.5, 5.0, 0.0), (3.0, 0.0, 2.0), (0.25, 2.5, 0.5), (-10.0, 3.0, -2.0),
    (math.inf, 3.0, 3.0), (3.0, -7.0, 2.0), (1.0, math.inf, 2.0)])
def test_value_at_acceleration_and_velocity_is_interpolated_and_clamped(acceleration, velocity, value):
    assert ValueMap(VALUES, VELOCITIES, ROWS).value_at(acceleration, velocity) == pytest.approx(value)
    assert naive_value_at(VALUES, VELOCITIES, ROWS, acceleration, min(velocity, 1e9)) == pytest.approx(value)


@pytest.mark.parametrize("value, velocity, acceleration", [
    (-2.0, 0.0, -4.0), (3.0, 10.0, 2.0), (0.5, 2.5, 0.25), (-9.0, 5.0, -5.0), (9.0, 5.0, 3.5), (1.0, -1.0, 1.0),
    (1.0, 11.0, 0.0)])
def test_acceleration_at_value_and_velocity_is_interpolated_and_clamped(value, velocity, acceleration):
    assert ValueMap(VALUES, VELOCITIES, ROWS).acceleration_at(value, velocity) == pytest.approx(acceleration)


@st.composite
def rising_axes(draw, start, min_size):
    axis = [draw(start)]
    for gap in draw(st.lists(GAPS, min_size=min_size - 1, max_size=4)):
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
@given(maps(), st.floats(-60, 60), st.floats(-60, 60), st.floats(-60, 60), st.floats(0, 1), st.data())
def test_lookup_in_any_map_equals_the_naive_one_rises_and_is_the_inverse_of_the_other(case, one, other, velocity,
                                                                                     part, data):
    values, velocities, rows = case
    value_map = ValueMap(values, velocities, rows)
    low, high = sorted((one, other))
    value = value_map.value_at(low, velocity)
    assert value == pytest.approx(naive_value_at(values, velocities, rows, low, velocity), abs=1e-6)
    assert value <= value_map.value_at(high, velocity) + 1e-9

    reachable = naive_row_accelerations(velocities, rows, velocity)
    assert value_map.acceleration_at(value, velocity) == pytest.approx(
        min(max(low, reachable[0]), reachable[-1]), abs=1e-6)
    value = values[0] + part * (values[-1] - values[0])
    assert value_map.value_at(value_map.acceleration_at(value, velocity), velocity) == pytest.approx(value, abs=1e-6)

    row, column = data.draw(st.integers(0, len(values) - 1)), data.draw(st.integers(0, len(velocities) - 1))
    assert value_map.value_at(rows[row][column], velocities[column]) == values[row]


@pytest.mark.once
@given(st.data())
def test_lookup_in_a_map_all_but_level_never_fails_nor_leaves_the_map(data):
    rows = data.draw(st.integers(2, 4))
    columns = data.draw(st.integers(2, 3))
    column = st.lists(NEARLY_LEVEL, min_size=rows, max_size=rows).map(sorted).filter(lambda drawn: drawn[0] < drawn[-1])
    table = [data.draw(column) for _ in range(columns)]
    values, velocities = [float(row) for row in range(rows)], [float(column) for column in range(columns)]
    value_map = ValueMap(values, velocities, list(zip(*table)), allow_plateaus=True)
    velocity = data.draw(st.floats(-1, 3) | st.sampled_from([5e-324, 1.0 - 2 ** -53]))
    assert 0 <= value_map.value_at(data.draw(NEARLY_LEVEL | st.floats(-3, 3)), velocity) <= rows - 1


@pytest.mark.parametrize("values, velocities, low, high, acceleration, velocity", [
    ([-3.0, -2.0, -1.9999999999999998, -1.0], [-0.9999999999999999, 3.0000000000000004],
     [1e-323, 0.0007312216794230751, 2.0000000000000004, 3.0], [-3.0000000000000004, -3.0, -5e-324, 1.5e-323],
     1e-323, 3.0),  # neighbours that a blend makes level
    ([-3.0, -1.0, 0.000644116475764579, 1.9999999999999998], [-0.9999999999999998, 0.0],
     [-2.0000000000000004, -1.4545737719662633, 0.0, 1.9999999999999996],
     [0.9999999999999998, 0.9999999999999999, 1.0, 1.9999999999999998], 0.9999999999999999, -5e-324),  # between them
])
def test_lookup_where_rounding_levels_neighbours_does_not_divide_by_their_difference(values, velocities, low, high,
                                                                                   acceleration, velocity):
    value = ValueMap(values, velocities, list(zip(low, high))).value_at(acceleration, velocity)
    assert values[0] <= value <= values[-1]


@pytest.mark.parametrize("values, value", [
    ([-2.0, -1.0, 0.0, 1.0, 2.0], 0.0),
    ([1.0, 2.0, 3.0, 4.0, 5.0], 2.0),
    ([-5.0, -4.0, -3.0, -2.0, -1.0], -2.0),
    ([-3.0, -1.5, 0.5, 0.75, 2.0], 0.0),  # between rows
])
@pytest.mark.parametrize("velocity", [0.0, 2.5, 10.0])
def test_plateau_gives_its_value_of_least_magnitude_between_columns_too(values, value, velocity):
    assert ValueMap(values, [0.0, 10.0], PLATEAU_ROWS, allow_plateaus=True).value_at(0.0, 0.0) == value
    rows = [[-1.0, -3.0], [0.5, -1.5], [0.5, -1.5], [0.5, -1.5], [2.0, 2.0]]
    value_map = ValueMap(values, [0.0, 10.0], rows, allow_plateaus=True)
    assert value_map.value_at(0.5 - 0.2 * velocity, velocity) == value


@pytest.mark.parametrize("accelerations, acceleration, value", [
    ((0, 0, 1), 0.0, 1.0), ((0, 0, 1), -0.1, 1.0), ((0, 1, 1), 1.0, 2.0), ((0, 1, 1), 1.1, 3.0)])
def test_plateau_at_an_end_of_the_map(accelerations, acceleration, value):
    rows = [(each, each) for each in accelerations]
    assert ValueMap([1.0, 2.0, 3.0], [0.0, 1.0], rows, allow_plateaus=True).value_at(acceleration, 0.5) == value


@pytest.mark.parametrize("values, velocities, rows, message", [
    ([1], [0, 1], [[1, 2]], "map, values is .1.; accepted: at least two"),
    ([1, 1], [0, 1], [[1, 2], [3, 4]], r"map, values\[1\] is 1; accepted: more than"),
    ([1, 2], [0], [[1], [2]], "map, velocities is .0.; accepted: at least two"),
    ([1, 2], [0, math.nan], [[1, 2], [3, 4]], r"map, velocities\[1\] is nan"),
    ([1, 2], [0, 1], [[1, 2]], "map, rows is 1; accepted: 2, one for each value"),
    ([1, 2], [0, 1], [[1, 2], [3]], "map, row of value 2 is .3.; accepted: 2 finite accelerations"),
    ([1, 2], [0, 1], [[1, 2], [3, math.inf]], "map, row of value 2 is .3, inf."),
    ([1, 2], [0, 1], [[1, -1e308], [3, 1e308]], "map, at velocity 1 m/s is .*; accepted: a finite span"),
    ([1, 2, 3], [0, 1], [[1, 2], [3, 2], [4, 3]],
     rf"map, at velocity 1 m/s, from value 1 to 2 stays level at 2.0 m/s²; {RISES} \(allow_plateaus: true takes level"),
    ([1, 2, 3], [0, 1], [[1, 2], [3, 4], [2, 5]],
     f"map, at velocity 0 m/s, from value 2 to 3 falls from 3.0 to 2.0 m/s²; {RISES}$"),
])
def test_map_with_a_fault_is_refused_naming_it(values, velocities, rows, message):
    with pytest.raises(ConfigError, match=message):
        ValueMap(values, velocities, rows, name="map")


def test_with_plateaus_allowed_a_level_stretch_is_loaded_and_a_falling_one_is_refused(tmp_path):
    path = written(tmp_path, "default,0,1\n1,2,3\n2,2,4\n3,3,5\n")
    assert load_value_map(path, allow_plateaus=True).value_at(2.0, 0.0) == 1.0
    with pytest.raises(ConfigError, match=r"from value 1 to 2 falls from 3.0 to 2.0 m/s²"):
        ValueMap([1, 2], [0, 1], [[3, 1], [2, 2]], allow_plateaus=True)


@pytest.mark.parametrize("allow_plateaus", [False, True])
@pytest.mark.parametrize("rows, velocity, level", [("0,0,0\n1,0,0\n2,0,0\n", "0.0", "0.0"),
                                                   ("0,-1,2\n1,0,2\n2,1,2\n", "1.0", "2.0")],
                         ids=["a_placeholder_of_zeros", "one_column"])
def test_column_that_is_level_from_end_to_end_is_refused_also_where_plateaus_are_allowed(
        tmp_path, rows, velocity, level, allow_plateaus):
    with pytest.raises(ConfigError, match=f"at velocity {velocity} m/s is {level} m/s² for every value; {RISES}$"):
        load_value_map(written(tmp_path, "default,0,1\n" + rows), allow_plateaus)


@pytest.mark.parametrize("rows", [
    "0,0.3,-0.4\n0.1,0.2,-0.5\n0.2,-0.3,-0.6\n", "0,0.3,-0.4\n0.1,0.2,-0.3\n0.2,-0.3,-0.6\n",
    "0,0,-0.4\n0.1,0,-0.5\n0.2,0,-0.6\n"], ids=["falling", "with_a_step_up", "with_a_level_column"])
def test_brake_map_of_autoware_is_refused_with_what_joins_it_to_its_accel_map(tmp_path, rows):
    with pytest.raises(ConfigError, match="map.csv has an acceleration that falls with value, as a brake_map has; "
                       f"{RISES}; check_map --brake brake_map.csv accel_map.csv -o value_map.csv joins Autoware's"):
        load_value_map(written(tmp_path, "default,0,1\n" + rows), allow_plateaus=True)


def written(tmp_path, content):
    path = tmp_path / "value_map.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return str(path)


@pytest.mark.parametrize("content", [
    GOOD.replace("\n", "\r\n"),
    b"\xef\xbb\xbf" + GOOD.encode(),
    GOOD.replace(",", " ,\t "),
    GOOD + "\n \n\r\n",
    GOOD.rstrip("\n"),
    GOOD.replace("\n", ",\n"),
    GOOD.replace("\n", ", \r\n", 2),
    GOOD.replace("default", ""),
    GOOD.replace("default", "Wägelchen"),
    GOOD.replace("-2.0,", "-2e0,").replace("10.0", "10"),
])
def test_file_is_loaded_with_other_line_ends_spaces_names_and_numbers(tmp_path, content):
    value_map = load_value_map(written(tmp_path, content))
    assert value_map.values == tuple(VALUES)
    assert value_map.velocities == tuple(VELOCITIES)
    assert [[value_map.acceleration_at(value, velocity) for velocity in VELOCITIES] for value in VALUES] == ROWS


@pytest.mark.parametrize("content, message", [
    ("\n\n", r"value_map.csv has 0 line\(s\); accepted: a line of velocities and at least two"),
    ("default,0,1\n1,2,3\n", r"has 2 line\(s\)"),
    ("default,0\n1,2\n2,3\n", r"line 1 is \['default', '0'\]; accepted: a name and at least two velocities"),
    ("default,0,1\n1,2,3\n2,3\n", "line 3 has 2 columns; accepted: 3, as in line 1"),
    ("default,0,1\n1,2,3,4\n2,3,4\n", "line 2 has 4 columns; accepted: 3, as in line 1"),
    ("default,0,1,\n1,2,3,,\n2,3,4,\n", "line 2 has 4 columns; accepted: 3, as in line 1"),
    ("default,0,1,\n1,2,,\n2,3,4,\n", f"line 2, column 3 is ''; {NO_NUMBER}"),
    ("default,0,1\n1,2,3\n\n2,3,4\n", "line 3 is blank; accepted: numbers; a blank line may only come last"),
    ("default,0,one\n1,2,3\n2,3,4\n", f"line 1, column 3 is 'one'; {NO_NUMBER}"),
    ("default,0,1\n1,2,3\n2,nan,4\n", f"line 3, column 2 is 'nan'; {NO_NUMBER}"),
    ("default,0,1\n1_0,2,3\n2,3,4\n", f"line 2, column 1 is '1_0'; {NO_NUMBER}"),
    ("default,1,1\n1,2,3\n2,3,4\n", "line 1, column 3 is 1.0; accepted: more than the one before it, 1.0"),
    ("default,0,1\n2,2,3\n1,3,4\n", "line 3, column 1 is 1.0; accepted: more than the one before it, 2.0"),
    ("default,0,1\n1,2,3\n2,2,4\n3,3,5\n", "at velocity 0.0 m/s, from value 1.0 to 2.0 stays level at 2.0"),
    (b"default,0,1\n1,2,3\n2,3,\xe9\n", NO_UTF_8),
    ("default,0," + "1" * 200_000 + "\n1,2,3\n2,3,4\n", NO_UTF_8 + "field larger"),
    (b"default,0,1\n1,2,3\n2,3,\x00\n", r"line 3, column 3|a CSV file in UTF-8"),
], ids=lambda text: text[-40:])
def test_file_with_a_fault_is_refused_naming_file_line_and_column(tmp_path, monkeypatch, content, message):
    monkeypatch.chdir(tmp_path)  # a message cuts a long path
    with pytest.raises(ConfigError, match=message) as caught:
        load_value_map(os.path.basename(written(tmp_path, content)))
    assert "value_map" in caught.value.name
    assert "value_map.csv" in str(caught.value)


@pytest.mark.parametrize("name, reason", [("missing.csv", "No such file or directory"), ("", "Is a directory"),
                                          ("large.csv", "it has 10.0 MB, more than 10 MB")])
def test_file_that_cannot_be_read_is_refused_naming_parameter_path_and_reason(tmp_path, name, reason):
    (tmp_path / "large.csv").touch()
    os.truncate(str(tmp_path / "large.csv"), 10_000_001)
    with pytest.raises(ConfigError, match=rf"csv_path_value_map is .*; accepted: a file that can be read \({reason}\)"):
        load_value_map(str(tmp_path / name))


def test_text_that_will_be_a_file_is_checked_before_there_is_one(tmp_path):
    path = str(tmp_path / "value_map.csv")
    assert load_value_map(path, text=GOOD).values == tuple(VALUES)
    with pytest.raises(ConfigError, match=rf"^{path} has 1 line\(s\)"):
        load_value_map(path, text="default,0,1\n")
    assert os.listdir(str(tmp_path)) == []


def test_shipped_map_covers_the_shipped_limits_and_brakes_at_every_velocity():
    value_map = load_value_map(str(SHIPPED))
    assert (value_map.values[0], value_map.values[-1]) == (-5.0, 3.0)
    assert value_map.velocities[0] == 0.0
    for velocity in value_map.velocities:
        assert value_map.value_at(0.0, velocity) >= 0.0
        assert value_map.value_at(-3.0, velocity) < 0.0
