"""The page about a calibration drive: its new table, not the one by which it drove."""
import math

import pytest

from car_interface.tools.recordings.calibration_result import CalibrationResult, SideRow, parsed
from car_interface.tools.report.drives import row
from car_interface.tools.report.faults import OK, WARN
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from tools.report.summaries import summarized
from written_recordings import HOSTILE, Written, drive

LEFT = (SideRow(3800, 1.05, 4000, 4.0, 0.006, 7, 12.4, "driven"), SideRow(3830, 1.03, 4470, 9.0, 0.021, 5, 8.0, "end"))
RIGHT = (SideRow(6700, 1.05, 6600, 6.0, 0.009, 6, 9.9, "driven"),
         SideRow(6650, -0.0001, 6100, math.inf, math.inf, 0, 0.0, "old"))
RESULT = CalibrationResult(
    "", ("backlash: 13 duty",), ("Launch again with config:=/home/me/my_car, which loads the table.",), (1.0, 2.0),
    LEFT, RIGHT, (5100, 4984.0), ((4000, 1.0), (6100, -0.5)), ((3800, 1.05, 0.01), (6700, -1.05, 0.01)),
    ((3800, 1.0), (6700, -1.0)))
OLD_TABLE = ("commanded left, 39.2 m, the car went left, 1.3 m: steering calibration? Measure which duty drives left, "
             "39.2 m")
COASTS = "no brake: below 0.5 m/s the ESC could take this pull for reverse before it is over: it coasts"


def status(time_s, level, text):
    return Written(time_s, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {"status": [
        {"level": level, "name": "turn_arb: turns", "message": text, "hardware_id": "", "values": []}]})


def summary_of(tmp_path, text):
    messages = [*drive(12.0), status(8.0, OK, "fine"), status(9.0, WARN, OLD_TABLE), status(10.0, OK, "fine"),
                Written(11.0, "/rosout", "rosgraph_msgs/Log", {"level": 4, "name": "/throttle_arb", "msg": COASTS}),
                Written(11.5, "/calibration_drive/result", "std_msgs/String", {"data": text})]
    return summarized(tmp_path, messages)


def words(text):
    return " ".join(text.replace("<wbr>", "").split())


def test_result_is_the_same_after_it_was_recorded():
    again = parsed(RESULT.text())
    assert (again.left, again.right) == (list(LEFT), list(RIGHT)) and parsed(again.text()) == again


@pytest.mark.parametrize("text", ["", "{}", "[]", "7", "[" * 100_000, RESULT._replace(radii_m=()).text(),
                                  RESULT._replace(curve=((1.0,),)).text(), RESULT._replace(left=((),)).text(),
                                  RESULT._replace(centers=(5100, math.nan)).text()],
                         ids=["empty", "object", "list", "number", "nested_too_deeply", "no_radii", "short_point",
                              "short_row", "no_number"])
def test_what_is_no_result_is_refused(text):
    with pytest.raises(ValueError, match=r"calibration drive's result (can't be read|has no table)"):
        parsed(text)


@pytest.mark.more
def test_page_has_the_new_table_with_the_old_one_beside_it_what_it_rests_on_and_what_to_do_next(tmp_path):
    seen = summary_of(tmp_path, RESULT.text())
    text = words(page(seen, plots(seen)))
    for shown in ("It was a calibration drive, and it gave a", "backlash: 13 duty", RESULT.next_steps[0],
                  "Straight on: duty 4984, it was 5100", 'data-plot="calibration"', "nothing was driven",
                  *('<td class="number">' + '</td><td class="number">'.join(cells) + "</td>" for cells in (
                      ("1 m", "3800", "0.95 m", "4000", "4", "0.6 %", "7", "12 m"),
                      ("2 m", "3830", "0.97 m", "4470", "9", "2.1 %", "5", "8 m")))):
        assert shown in text, shown


def test_old_table_is_no_fault_of_a_calibration_drive_nor_that_it_coasts(tmp_path):
    seen = summary_of(tmp_path, RESULT.text())
    text = words(page(seen, {}))
    assert "the tables say" not in text and "calibrate_steering makes tables" not in text
    assert not {OLD_TABLE, COASTS} & {fault.what for fault in seen.faults.entries}
    found = row(seen, "drive.bag")
    assert found.left_ratio is found.right_ratio is found.straight_per_m is None
    assert found.notes[-1] == "a calibration drive"


def test_drive_whose_result_is_none_says_so_and_has_the_page_of_any_drive(tmp_path):
    seen = summary_of(tmp_path, "")
    assert seen.calibration is None and 'id="calibration"' not in page(seen, {})
    assert any(note.startswith("the calibration drive's result ") for note in seen.notes)
    assert {OLD_TABLE, COASTS} <= {fault.what for fault in seen.faults.entries}


def test_refused_drive_says_why_and_its_texts_are_only_texts(tmp_path):
    seen = summary_of(tmp_path, RESULT._replace(refusal=HOSTILE, lines=(HOSTILE,), next_steps=(HOSTILE,)).text())
    text = page(seen, {})
    assert "No table was written: " in text and HOSTILE not in text
