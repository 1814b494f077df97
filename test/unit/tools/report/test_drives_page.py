"""The table of all drives, as a page and as CSV."""
import csv
import html
import io
import re

import pytest

from car_interface.tools.report.drives import Row, csv_text, in_order, page
from written_recordings import START_NS

CSV_COLUMNS = ("recording", "start_utc", "duration_s", "distance_km", "gamepad_s", "planner_s", "losses",
               "losses_by_cause", "straight_per_m", "left_ratio", "right_ratio", "map_drive_mps2", "map_hold_mps2",
               "map_brake_mps2", "battery_min_v", "frames", "corrupt_frames", "port_reopened", "teensy_reboots",
               "pings_unanswered", "faults", "errors", "cant_tell", "notes", "error")
DAY_NS = 86_400_000_000_000
FULL = Row("a.bag", start_ns=START_NS, duration_s=125.0, distance_m=1234.5, gamepad_s=12.0, planner_s=100.0,
           losses={"planner silent": 2, "e_stop": 1}, straight_per_m=-0.0123, left_ratio=1.25, right_ratio=1.005,
           drive_mps2=-0.204, hold_mps2=0.011, brake_mps2=None, battery_v=6.418, frames=990, corrupt=10,
           reopened=1, reboots=2, unanswered=3, faults=5, errors=2)
BLIND = Row("b.bag", start_ns=47_000_000_000, duration_s=61.2, distance_m=84.2,
            lacks=["/turn_arb/state", "/rosout for 12 s"], notes=["odom: /ekf (the only nav_msgs/Odometry)"])
BAD = Row("<c>.bag", error="c.bag can't be read as a recording: it is no bag")


def shown(*rows):
    """The rows of the page's table, as their reader sees them."""
    text = page("drives", rows, "", {})
    text = text[text.index('<section id="drives">'):].replace("<br>", " / ")
    return [[html.unescape(re.sub("<[^>]*>", "", cell)).strip(" /") for cell in re.findall("<td[^>]*>(.*?)</td>", line)]
            for line in text.split("\n") if line.startswith("<tr><td")]


def test_row_says_everything_that_its_recording_tells():
    assert shown(FULL)[0] == [
        "a.bag", "2023-11-14 22:13", "1.234 km / 2 min 5 s", "gamepad 12.0 s / planner 1 min 40 s",
        "planner silent (2×) / e_stop",
        "straight on: 0.012 1/m right / left: 20% tighter / right: as the tables",
        "driving: -0.20 m/s² / holding: +0.01 m/s²", "6.42 V",
        ("10 of 1000 frames corrupt / port opened again: 1 / Teensy started anew: 2 / pings unanswered: 3"),
        "5, 2 errors"]


def test_recording_that_can_not_tell_says_so_in_every_column_and_why():
    (name, *cells), = shown(BLIND)
    assert name == ("b.bag / can't tell: no /turn_arb/state, no /rosout for 12 s / "
                    "odom: /ekf (the only nav_msgs/Odometry)")
    assert cells == ["no date", "0.084 km / 61.2 s", *["can't tell"] * 7]


def test_row_says_none_where_it_could_tell_and_none_seen_where_it_could_not():
    assert shown(BLIND._replace(faults=0, errors=0))[0][-1] == "0 seen"
    good = FULL._replace(faults=0, errors=0, gamepad_s=0.0, planner_s=0.0, losses={}, straight_per_m=0.0123,
                         left_ratio=0.002, right_ratio=None)
    ((_, _, _, who, lost, steering, *_, faults),) = shown(good)
    assert (who, lost, faults) == ("nobody", "none", "0")
    assert steering == "straight on: 0.012 1/m left / left: more than 10 times wider"


def test_recording_that_can_not_be_read_says_why_below_the_table_and_its_name_is_escaped():
    text = page("drives", [FULL, BAD], "", {})
    assert text.index('id="unreadable"') > text.index('id="drives"') and '<a href="#unreadable">' in text
    assert ("<td>&lt;c&gt;.bag</td><td><span class=\"bad\">c.bag can&#39;t be read as a recording: it is no bag"
            "</span></td>") in text
    assert 'id="drives"' not in page("drives", [BAD], "", {})
    assert 'id="unreadable"' not in page("drives", [FULL], "", {})


def test_no_text_from_outside_is_anything_but_text():
    hostile = "</td><script>alert('\"')</script>&amp;{{ 7 * 7 }}"
    row = FULL._replace(path=hostile, losses={hostile: 2}, lacks=[hostile], notes=[hostile, hostile])
    text = page(hostile, [row, BAD._replace(path=hostile, error=hostile)], "", {})
    assert "<script" not in text and html.unescape(text).count(hostile) == 9  # twice as the folder: title and heading


def test_newest_comes_first_and_the_head_has_the_sums():
    rows = in_order([BAD, FULL._replace(path="later.bag", start_ns=START_NS + DAY_NS), BLIND, FULL])
    assert [row.path for row in rows] == ["b.bag", "a.bag", "later.bag", "<c>.bag"]
    assert [line[0].split(" ")[0] for line in shown(*rows)] == ["later.bag", "a.bag", "b.bag", "<c>.bag"]
    text = page("drives", rows, "<svg/>", {})
    figures = re.findall("<div><b>(.*?)</b><span>(.*?)</span></div>", text)
    assert figures == [("3", "drives"), ("1", '<a href="#unreadable">can\'t be read</a>'), ("2.55 km", "driven"),
                       ("5 min 11 s", "recorded"), ("6", "times lost or locked")]
    assert '<p class="faint">2023-11-14 22:13:20 UTC to 2023-11-15 22:13:20 UTC</p>' in text and "<svg/>" in text


def test_csv_has_a_line_for_each_row_and_leaves_empty_what_nobody_knows():
    lines = list(csv.DictReader(io.StringIO(csv_text([FULL, BLIND, BAD]))))
    assert tuple(lines[0]) == CSV_COLUMNS
    full, blind, bad = lines
    assert (full["start_utc"], full["distance_km"], full["losses"], full["losses_by_cause"]) == (
        "2023-11-14T22:13:20Z", "1.2345", "3", "e_stop: 1; planner silent: 2")
    assert (full["map_drive_mps2"], full["map_brake_mps2"], full["corrupt_frames"]) == ("-0.204", "", "10")
    assert (blind["start_utc"], blind["losses"], blind["cant_tell"]) == ("", "", "/turn_arb/state; /rosout for 12 s")
    assert blind["faults"] == blind["errors"] == ""
    assert bad["error"] == BAD.error and set(bad.values()) == {"<c>.bag", BAD.error, ""}


@pytest.mark.parametrize("text", [
    "=1+1.bag", "+1.bag", "-1.bag", "@SUM(A1).bag", "\t=1.bag", "\r=1.bag", "\n=1.bag", "\uff1d1.bag", "\u22121.bag"])
def test_text_that_a_spreadsheet_would_take_for_a_formula_is_marked_as_text(text):
    (line,) = csv.DictReader(io.StringIO(csv_text([FULL._replace(
        path=text, losses={text: 1}, notes=[text], lacks=[text])]), newline=""))
    assert line["recording"] == line["notes"] == line["cant_tell"] == f"'{text}"
    assert line["losses_by_cause"] == f"'{text}: 1"


def test_csv_keeps_numbers_below_0_and_ordinary_texts_and_no_zero_byte():
    text = csv_text([FULL])
    assert '"a.bag"' in text and ",-0.0123,1.25,1.005,-0.204,0.011,,6.418," in text and "'" not in text
    (line,) = csv.DictReader(io.StringIO(csv_text([FULL._replace(losses={"a\0b": 1})])))
    assert line["losses_by_cause"] == "a\ufffdb: 1"


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_text_within_a_cell_begins_no_cell_of_its_own(delimiter):
    text = csv_text([FULL._replace(path="a;=1+1;b\n=2,=3.bag")])
    cells = [cell for line in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) for cell in line]
    assert not [cell for cell in cells if cell.startswith("=")]
