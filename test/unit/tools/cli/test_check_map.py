"""check_map: the loader's own verdict, a picture in the terminal, and one in a file."""
import bisect
import re
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from car_interface.steering.config import load_steering
from car_interface.throttle.value_map import ValueMap, load_value_map
from car_interface.tools.cli import check_map
from car_interface.tools.cli.check_map import map_notes, map_picture, steering_notes, steering_picture
from car_interface.tools.cli.main import main

ROOT = Path(__file__).resolve().parents[4]
STOCK = ROOT / "config" / "turn_arb.yaml"
STOCK_MAP = ROOT / "config" / "value_map.csv"
STOCK_TEXT = STOCK.read_text(encoding="utf-8")


def steering_file(tmp_path, **changes):
    """The stock calibration with other values; None takes one away."""
    values = {**yaml.safe_load(STOCK.read_text(encoding="utf-8")), **changes}
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({name: value for name, value in values.items() if value is not None}))
    return path


def map_file(tmp_path, text):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name, text, words", [
    ("a.yaml", STOCK_TEXT.replace("servo_left:", "servo_lfet:"), "servo_left is missing|unknown parameter servo_lfet"),
    ("a.yaml", STOCK_TEXT.replace("servo_center: 5100", "servo_center: 9000"), "servo_center is 9000; accepted: a"),
    ("a.yaml", "- 1\n- 2\n", "YAML lines of a parameter's name"),
    ("a.yaml", "a: [1\n", "is no YAML"),
    ("a.yaml", None, "can't be read"),
    ("a.csv", "default,0,1\n0,0,0\n1,1,0\n2,2,1\n", "from value 0.0 to 1.0 stays level"),
    ("a.csv", "default,0,1\n0,0,0\n1,0,0\n", "at velocity 0.0 m/s is 0.0 m/s² for every value"),
    ("a.csv", "default,0,1\n0,0,0\n1,-1,-1\n", "as a brake_map has; .* check_map --brake brake_map.csv accel_map.csv"),
    ("a.csv", "default,0,1\n0,0,0\n1,1,x\n", "line 3, column 3"),
    ("a.csv", "", "has 0 line"),
], ids=lambda part: (part or "").split("\n")[0][:20])
def test_bad_table_is_refused_in_its_nodes_words(name, text, words, tmp_path, capsys):
    path = tmp_path / name
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert main("check_map", [str(path)]) == 1
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and str(path) in shown.err and re.search(words, shown.err)


# --- pictures in the terminal ---

def test_steering_picture_has_a_line_for_each_radius_with_bars_as_long_as_the_way_of_the_servo(tmp_path):
    lines = steering_picture(load_steering(str(STOCK)))[3:]
    assert len(lines) == 15
    left, right = (lines[0].split("│")[side].count("█") for side in (0, 1))
    assert (left, right) == (round(24 * 1300 / 1600), 24)
    assert [line.split("│")[0].count("█") for line in lines] == sorted(
        (line.split("│")[0].count("█") for line in lines), reverse=True)
    assert lines[-1].count("█") == 0 and "300 m" in lines[-1]
    reversed_servo = steering_file(
        tmp_path, servo_left=6700, servo_right=3800, k_pwmcmd_left_table_servo=[6700] * 14 + [5100],
        k_pwmcmd_right_table_servo=[3800] * 14 + [5100])
    assert steering_picture(load_steering(str(reversed_servo)))[3].split("│")[0].count("█") == 24


def test_map_picture_shows_small_maps_whole_and_large_ones_thinned_with_their_ends():
    table = ValueMap([0, 1], [0, 2], [[-1, -2], [3, 2.5]])
    small = map_picture(table)
    assert "       1 │  3.00   2.50 " in small and "       0 │ -1.00  -2.00 " in small
    assert "\033" not in "".join(small) and "\033[48;5;" in "".join(map_picture(table, colour=True))
    axis = list(range(100))
    large = map_picture(ValueMap(axis, axis, [[value - 50 for _ in axis] for value in axis]))
    assert len([line for line in large if "│" in line]) == check_map.MAX_ROWS
    assert all(len(line) < 100 for line in large)
    assert " 49.00" in large[2] and "-50.00" in large[-3]


def test_terminal_without_blocks_gets_plain_characters(monkeypatch, tmp_path):
    with open(str(tmp_path / "out"), "w", encoding="ascii") as out:
        monkeypatch.setattr(sys, "stdout", out)
        assert main("check_map", [str(STOCK)]) == 0
    assert "####|####" in (tmp_path / "out").read_text(encoding="ascii")


# --- notes ---

@pytest.mark.parametrize("changes, words", [
    pytest.param({}, ["can't tell apart .*: 4 and 5 m, 6 and 7 m"], id="stock"),
    pytest.param({"k_pwmcmd_right_table_servo": [6700 - 100 * index for index in range(13)] + [5550, 5100]},
                 ["can't tell apart", "to the right the duty goes back from 5500 to 5550 .* 80 to 100 m"],
                 id="going_back"),
    pytest.param({"servo_right": 6500}, ["tell apart", "beyond servo_right 6500"], id="beyond_the_end"),
    pytest.param({"m_turnrad_axis_servo": [index + 1 for index in range(14)] + [99]},
                 ["a planner that asks for wider turns gets 99 m"], id="axis_that_ends_early"),
])
def test_notes_tell_what_turn_arb_takes_and_an_owner_may_want_to_know(changes, words, tmp_path):
    notes = list(steering_notes(load_steering(str(steering_file(tmp_path, **changes)))))
    assert len(notes) >= len(words)
    for word in words:
        assert any(re.search(word, note) for note in notes), (word, notes)


@pytest.mark.parametrize("widest_m, is_enough", [(99, False), (100, True)])
def test_a_table_should_reach_100_m(widest_m, is_enough, tmp_path):
    path = steering_file(tmp_path, m_turnrad_axis_servo=[index + 1 for index in range(14)] + [widest_m])
    notes = "".join(steering_notes(load_steering(str(path))))
    assert ("nothing here goes straight on" not in notes) == is_enough


@pytest.mark.parametrize("values, velocities, accelerations, words", [
    ([-1, 0, 2], [0, 5, 10], [[-2, -3, -4], [-0.1, -1, -2], [3, 1, -0.5]],
     ["at 10 m/s it has no value for 0 m/s², only for -4 to -0.5", "0 m/s² takes the value 0.0645 at 0 m/s"]),
    ([0, 1, 2], [0, 5], [[0, -1], [1, 0.5], [2, 1]], ["0 m/s² takes the value 0 at 0 m/s and 0.667 at 5 m/s"]),
    ([0, 1], [0, 2], [[1, 2], [3, 2.5]], ["at 0 m/s it has no value for 0 m/s², only for 1 to 3",
                                         "at 2 m/s it has no value for 0 m/s², only for 2 to 2.5"]),
], ids=["not_at_the_last_velocity", "at_both_velocities", "at_neither"])
def test_value_for_0_is_told_where_the_map_has_it_and_only_there(values, velocities, accelerations, words):
    assert [note for note in map_notes(ValueMap(values, velocities, accelerations)) if "0 m/s²" in note] == words


def test_plateaus_and_limits_of_the_converter_may_be_allowed(tmp_path, capsys):
    assert main("check_map", [str(map_file(tmp_path, "default,0,1\n0,0,0\n1,1,0\n2,2,1\n")), "--allow-plateaus"]) == 0
    path = map_file(tmp_path, "default,0,1\n-1,-1,-1\n6,1,1\n")
    assert main("check_map", [str(path)]) == 0
    assert "generic_value_converter clamps to min_value -5 … max_value 3" in capsys.readouterr().out
    assert main("check_map", [str(path), "--max-value", "6"]) == 0 and "clamps" not in capsys.readouterr().out
    path = map_file(tmp_path, "default,0,1\n3300,-1,-1\n6500,1,1\n")
    assert main("check_map", [str(path)]) == 1
    shown = capsys.readouterr()
    assert shown.out == "" and str(path) in shown.err and "max_value 3.0" in shown.err, "wholly beyond the limits"


# --- pictures in files ---

@pytest.mark.parametrize("table, node, ending, begin", [
    (STOCK, "turn_arb", "svg", b"<?xml"), (STOCK_MAP, "generic_value_converter", "png", b"\x89PNG")])
def test_stock_tables_are_taken_and_their_picture_is_of_the_kind_that_its_name_says(
        table, node, ending, begin, tmp_path, capsys):
    path = tmp_path / f"picture.{ending}"
    assert main("check_map", [str(table), "-o", str(path)]) == 0
    assert path.read_bytes().startswith(begin) and path.stat().st_size > 5000
    shown = capsys.readouterr()
    assert shown.out.startswith(f"{table}: {node} takes it\n") and f"drawn in {path}" in shown.out and shown.err == ""
    for name in ("picture.jpg", "map.csv"):  # that is for two maps
        assert main("check_map", [str(table), "-o", name]) == 1
        shown = capsys.readouterr()
        assert shown.out == "" and "accepted: a name that ends in .svg, .png, .pdf\n" in shown.err


# --- Autoware's two maps ---

# Other velocities in each, other rows of value 0, a comma at the end of each line.
ACCEL = ("default,0,1.4,5.6,\n0,0.31,-0.02,-0.4,\n0.1,0.64,0.34,0.13,\n0.3,1.75,1.4,1.14,\n0.5,3.3,3.12,2.7,\n")
BRAKE = ("default,0,2.8,4.2,7,\n0,0.31,-0.2,-0.3,-0.5,\n0.1,0.2,-0.3,-0.45,-0.6,\n0.3,-1,-1.4,-1.5,-1.6,\n"
         "0.8,-2.2,-2.7,-2.8,-2.9,\n")


class AutowareMap:
    """One of Autoware's maps, as its converter uses it: by rows at the velocity, which is clamped; NaN is not asked."""

    def __init__(self, text):
        (_, *velocities), *rows = [line.rstrip(",").split(",") for line in text.splitlines()]
        self.velocities = [float(velocity) for velocity in velocities]
        self.rows = [(float(value), [float(cell) for cell in cells]) for value, *cells in rows]

    def curve(self, velocity):
        """(acceleration, value) of each row at a velocity."""
        velocity = min(max(velocity, self.velocities[0]), self.velocities[-1])
        return [(interpolated(list(zip(self.velocities, cells)), velocity), value) for value, cells in self.rows]


def interpolated(points, x):
    right = min(max(bisect.bisect_right([at for at, _ in points], x), 1), len(points) - 1)
    (x0, y0), (x1, y1) = points[right - 1], points[right]
    return y0 + (y1 - y0) * (x - x0) / (x1 - x0)


def throttle_less_brake(accel, brake, acceleration, velocity):
    """What Autoware sends: a throttle from its accel_map's first row on, else a brake, both limited to their maps."""
    pushes, brakes = accel.curve(velocity), brake.curve(velocity)
    if acceleration >= pushes[0][0]:
        return interpolated(pushes, min(acceleration, pushes[-1][0]))
    return -interpolated(brakes[::-1], min(max(acceleration, brakes[-1][0]), brakes[0][0]))


@pytest.fixture(scope="module")
def joined(tmp_path_factory):
    folder = tmp_path_factory.mktemp("two_maps")
    (folder / "accel_map.csv").write_text(ACCEL)
    (folder / "brake_map.csv").write_text(BRAKE)
    assert main("check_map", ["--brake", str(folder / "brake_map.csv"), str(folder / "accel_map.csv"), "-o",
                              str(folder / "value_map.csv")]) == 0
    return folder


@pytest.mark.once
@given(st.floats(-4, 4), st.floats(-2, 9))
def test_joined_map_answers_as_autoware_does_with_its_two_maps_but_for_brakes_below_the_first(
        joined, acceleration, velocity):
    accel, brake = AutowareMap(ACCEL), AutowareMap(BRAKE)
    value = load_value_map(str(joined / "value_map.csv")).value_at(acceleration, velocity)
    expected = throttle_less_brake(accel, brake, acceleration, velocity)
    first_brake, first = brake.curve(velocity)[1]
    if first_brake < acceleration < accel.curve(velocity)[0][0]:
        assert -first <= min(value, expected) and max(value, expected) <= 0
    else:
        assert value == pytest.approx(expected, abs=1e-7)


def test_joined_map_is_shown_written_and_drawn_and_an_old_one_is_kept(joined, capsys):
    arguments = ["--brake", str(joined / "brake_map.csv"), str(joined / "accel_map.csv")]
    assert (joined / "value_map.csv").read_text().splitlines()[:2] == [
        "default,0.0,1.4,2.8,4.2,5.6,7.0", "-0.8,-2.2,-2.45,-2.7,-2.8,-2.85,-2.9"]
    assert main("check_map", arguments) == 0
    both = f"{joined / 'accel_map.csv'} with {joined / 'brake_map.csv'}"
    assert capsys.readouterr().out.startswith(f"{both}: generic_value_converter takes it\n\nacceleration in m/s²; 7 va")
    assert main("check_map", [*arguments, "-o", str(joined / "value_map.csv")]) == 0
    assert f"written: {joined / 'value_map.csv'}; the old one is {joined}" in capsys.readouterr().out
    assert main("check_map", [*arguments, "-o", str(joined / "map.svg")]) == 0
    assert (joined / "map.svg").read_bytes().startswith(b"<?xml")
    before = (joined / "brake_map.csv").read_text()
    assert main("check_map", [*arguments, "-o", str(joined / "brake_map.csv")]) == 1
    assert (joined / "brake_map.csv").read_text() == before


@pytest.mark.parametrize("accel, brake, words", [
    (BRAKE, BRAKE, "a.csv is another map; accepted: Autoware's accel_map, whose acceleration rises with value"),
    (ACCEL, ACCEL, "b.csv is another map; accepted: Autoware's brake_map, whose acceleration falls with value"),
    (ACCEL.replace("\n0,", "\n0.05,"), BRAKE, "a.csv, line 2, column 1 is 0.05; accepted: 0, with which Autoware's"),
    (ACCEL, BRAKE.replace("0.1,0.2", "0.1,x"), "b.csv, line 3, column 2 is 'x'"),
    (ACCEL, BRAKE.replace("0.1,0.2", "0.1,0.4"), "from value -0.1 to 0.0 falls from 0.4 to 0.31 m/s²"),
    (ACCEL, BRAKE.replace("0.1,0.2", "0.1,0.31"), "from value -0.1 to 0.0 stays level at 0.31 m/s²"),
], ids=["two_brake_maps", "two_accel_maps", "no_0", "no_number", "a_brake_that_pushes", "a_brake_that_does_nothing"])
def test_two_maps_that_do_not_belong_together_are_refused_in_one_line(accel, brake, words, tmp_path, capsys):
    (tmp_path / "a.csv").write_text(accel)
    (tmp_path / "b.csv").write_text(brake)
    made = tmp_path / "m.csv"
    assert main("check_map", ["--brake", str(tmp_path / "b.csv"), str(tmp_path / "a.csv"), "-o", str(made)]) == 1
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and words in shown.err and not made.exists()
