"""What a first check writes: single values of the car's files, each checked as its node would load it; and its page."""
import builtins
import os
import shutil
from pathlib import Path

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.common.yaml_file import read_yaml
from car_interface.steering.config import load_steering
from car_interface.throttle.config import load_throttle
from car_interface.tools.first_check.files import find_folder, plan, write, write_page
from car_interface.tools.first_check.questions import BROKEN, FINE, LEARNED, SKIPPED, Result

CONFIG = Path(__file__).resolve().parents[4] / "config"
CHANGES = {"turn_arb": {"servo_left": 3800, "servo_center": 5060}, "teleop_logi": {"steer_scale": -1.0},
           "throttle": {"esc/profile": "forward_only", "servo/neutral": 4925,
                        "servo/duty_table": [3287.0, 4925.0, 6564.0]},
           "teensy_sensor_hub": {"sonar_sequence": [0, 1, 4]}}


@pytest.fixture
def folder(tmp_path):
    shutil.copytree(CONFIG, tmp_path / "my_car")
    return str(tmp_path / "my_car")


def test_values_are_written_where_they_differ_comments_stay_and_the_old_files_are_kept(folder):
    edits = plan(folder, CHANGES)
    assert [line for edit in edits for line in edit.lines] == [
        "turn_arb.yaml: servo_center 5100 → 5060", "teleop_logi.yaml: steer_scale 1.0 → -1.0",
        "throttle.yaml: esc/profile unverified → forward_only", "throttle.yaml: servo/neutral 4915 → 4925",
        "throttle.yaml: servo/duty_table [3277, 4915, 6554] → [3287, 4925, 6564]",
        "teensy_sensor_hub.yaml: sonar_sequence [] → [0, 1, 4]"]
    assert sorted(os.listdir(folder)) == sorted(os.listdir(CONFIG))  # so far nothing is written
    lines = write(edits)
    assert len(lines) == 4
    assert lines[0].startswith(f"written: {folder}/turn_arb.yaml; the old one is {folder}/turn_arb.yaml.bak-")
    assert load_steering(f"{folder}/turn_arb.yaml").servo_center == 5060
    assert load_throttle(f"{folder}/throttle.yaml").esc.profile == "forward_only"
    assert "# straight ahead" in read_yaml(f"{folder}/turn_arb.yaml")
    backup = lines[0].rpartition(" ")[2]
    assert Path(backup).read_text(encoding="utf-8") == (CONFIG / "turn_arb.yaml").read_text(encoding="utf-8")


def test_what_gamepads_yaml_has_for_the_gamepad_is_not_written_where_it_does_not_count(folder):
    edit, = plan(folder, {"teleop_logi": {"steer_scale": -1.0, "manual_button": 2}}, {"steer_scale": 1.0})
    assert edit.lines == [
        "teleop_logi.yaml can't be changed: for this gamepad gamepads.yaml has steer_scale: run map_gamepad again"]
    assert write([edit]) == []
    assert plan(folder, {"turn_arb": {"servo_center": 5060}}, {"servo_center": 1})[0].lines == [
        "turn_arb.yaml: servo_center 5100 → 5060"]


def test_kind_of_esc_that_was_measured_before_is_unmeasured_when_a_person_saw_another_one(folder):
    path = Path(folder, "throttle.yaml")
    path.write_text(path.read_text(encoding="utf-8").replace(
        "profile: unverified", "profile: brake_then_reverse\n  profile_measured: true"), encoding="utf-8")
    write(plan(folder, {"throttle": {"esc/profile": "direct_reverse"}}))
    esc = load_throttle(str(path)).esc
    assert (esc.profile, esc.profile_measured) == ("direct_reverse", False)


@pytest.mark.parametrize("spoil, problem", [
    (lambda path: path.unlink(), "No such file"),
    (lambda path: path.write_text("servo_left: [1", encoding="utf-8"), "turn_arb.yaml"),
    (lambda path: path.write_text("servo_center: 5100\n", encoding="utf-8"), "servo_right is missing")])
def test_file_that_its_node_would_refuse_is_left_alone_and_named_and_the_others_are_written(folder, spoil, problem):
    spoil(Path(folder, "turn_arb.yaml"))
    edits = plan(folder, CHANGES)
    assert edits[0].lines[0].startswith("turn_arb.yaml can't be changed: ") and problem in edits[0].lines[0]
    assert len(write(edits)) == 3 and not list(Path(folder).glob("turn_arb.yaml.bak*"))


def test_button_of_another_deadman_is_refused_by_name(folder):
    edit, = plan(folder, {"teleop_logi": {"manual_button": 5}})
    assert "autonomous_button is 5; accepted: a button other than manual_button's" in edit.lines[0]


def test_long_tables_are_shown_by_their_ends(folder):
    edit, = plan(folder, {"turn_arb": {"k_pwmcmd_left_table_servo": [3900.0] * 15}})
    assert edit.lines == ["turn_arb.yaml: k_pwmcmd_left_table_servo [3800, … 5100] → [3900, … 3900]"]


@pytest.mark.parametrize("folder, text", [(None, "turn_arb isn't launched"), (str(CONFIG), "the package's own files")])
def test_car_without_a_folder_of_its_own_is_refused_before_anything_is_asked(folder, text):
    with pytest.raises(CarInterfaceError, match=text):
        find_folder(folder)


RESULTS = [("the deadman", Result(FINE, "seen <held>")), ("the ESC's kind", Result(SKIPPED, "skipped")),
           ("the left wheel", Result(BROKEN, "counts nothing", repair="its plug")),
           ("the center", Result(LEARNED, "straight at duty 5060"))]


def test_page_says_what_was_checked_answered_written_and_is_to_be_repaired(tmp_path):
    path = str(tmp_path / "page.html")
    assert write_page(path, "2026-11-25 21:00", RESULTS, ["turn_arb.yaml: servo_center 5100 → 5060"]) == f"page: {path}"
    text = Path(path).read_text(encoding="utf-8")
    for part in ("<h1>First check</h1>", "2026-11-25 21:00", "seen &lt;held&gt;", "counts nothing",
                 "<th>the left wheel</th><td>its plug</td>", "servo_center 5100 → 5060",
                 '<span class="bad level">to be repaired</span>'):
        assert part in text
    assert "script" not in text and "Nothing is to be done" not in text
    write_page(path, "", RESULTS[:1], [])
    assert "Nothing is to be done." in Path(path).read_text(encoding="utf-8")


def test_page_of_a_check_with_questions_left_out_does_not_say_that_nothing_is_to_be_done(tmp_path):
    path = str(tmp_path / "page.html")
    write_page(path, "", RESULTS[:2], [])
    text = " ".join(Path(path).read_text(encoding="utf-8").split())
    assert "Nothing is to be done." not in text and "1 of 2 questions were not asked" in text


def test_page_that_cannot_be_made_is_said_and_fails_nothing(tmp_path, monkeypatch):
    assert write_page(str(tmp_path / "none" / "page.html"), "", RESULTS, []).startswith("no page: ")
    real = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", lambda name, *rest: real(
        "no_such_module" if name.endswith("report.html") else name, *rest))
    assert write_page(str(tmp_path / "page.html"), "", RESULTS, []) == "no page: sudo apt install python3-jinja2"
