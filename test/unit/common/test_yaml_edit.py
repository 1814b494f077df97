"""Values saved back to YAML: what changes in the file, what does not, and when nothing is touched at all."""
import os
import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import edited, rewritten, save

CONFIG = Path(__file__).resolve().parents[3] / "config"


@pytest.mark.parametrize("before, values, after", [
    ("a: 1  # why\nb: 2\n", {"a": 5}, "a: 5  # why\nb: 2\n"),
    ("a: 1\r\nb: 2\r\n", {"a": 5}, "a: 5\r\nb: 2\r\n"),
    ("\ufeffä: 'ö'\na: 1", {"a": 5}, "\ufeffä: 'ö'\na: 5"),
    # the same value in another spelling is left alone
    ("a: 0x0A\n", {"a": 10}, "a: 0x0A\n"),
    ("t: [0x0A, 1]\n", {"t": [10, 2]}, "t: [0x0A, 2]\n"),
    ("a: 1\n", {"a": 2.5}, "a: 2.5\n"),
    ("a: {b: 1}\n", {"a": 2}, "a: 2\n"),
    ("servo:\n  neutral: 4915  # 1.5 ms\n  channel: 1\n", {"servo/neutral": 4950},
     "servo:\n  neutral: 4950  # 1.5 ms\n  channel: 1\n"),
    ("servo: {neutral: 1, x: [1, 2]}\n", {"servo/neutral": 2, "servo/x": [1, 3]}, "servo: {neutral: 2, x: [1, 3]}\n"),
    ("t: [5100, 0,  0]  # first one steers\n", {"t": [5150, 0, 0]}, "t: [5150, 0,  0]  # first one steers\n"),
    ("t:\n- 1  # one\n- 2\n", {"t": [1, 3]}, "t:\n- 1  # one\n- 3\n"),
    # one number stands for a list of equal ones
    ("t: 5\n", {"t": [5, 5]}, "t: 5\n"),
    ("t: 5  # all\n", {"t": [6, 5]}, "t: [6, 5]  # all\n"),
    ("t: [1, 2]\n", {"t": []}, "t: []\n"),
    ("a: 1", {"a": 1, "b": [2, 3]}, "a: 1\nb: [2, 3]\n"),
    # what only rosparam understands stays
    ("b: !degrees 3\nc: deg(90)\nd: .nan\ne: 2026-01-01\nf: ~\na: 1\n", {"a": 2},
     "b: !degrees 3\nc: deg(90)\nd: .nan\ne: 2026-01-01\nf: ~\na: 2\n"),
    ("x: &n 3\ny: *n\na: 1\n", {"a": 2}, "x: &n 3\ny: *n\na: 2\n"),
], ids=repr)
def test_only_what_differs_is_rewritten(before, values, after):
    assert edited(before, values) == after


@pytest.mark.parametrize("before, values, after", [
    ("a: 1  # one\nb: 2  # two\n", {"a": 5}, "a: 5\nb: 2  # two\n"),
    ("# on a line of its own\na: 1  # one\n", {"a": 1}, "# on a line of its own\na: 1  # one\n"),
    ("t:\n- 1  # one\n- 2  # two\n", {"t": [1, 3]}, "t:\n- 1  # one\n- 3\n"),
], ids=repr)
def test_comments_behind_changed_values_are_removed_on_request(before, values, after):
    assert edited(before, values, keeps_comments=False) == after


@pytest.mark.parametrize("before, after", [
    ("# the kind\nesc:\n  kind: none  # as yet\nb: 2\n", "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\nb: 2\n"),
    ("esc:\n    kind: none\n    x: 1  # one\n\n# about b\nb: 2",
     "esc:\n    kind: fast\n    x: 1  # one\n    seen: true\n    dwell: 0.3\n\n# about b\nb: 2"),
    ("esc:\n  t: [1,\n      2]\n  kind: none\n  s:\n  - 1\nb: 2\n",
     "esc:\n  t: [1,\n      2]\n  kind: fast\n  s:\n  - 1\n  seen: true\n  dwell: 0.3\nb: 2\n"),
    ("b: 2\n", "b: 2\nesc:\n  kind: fast\n  seen: true\n  dwell: 0.3\n"),
    ("esc: {kind: fast}\nb: 2\n", "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\nb: 2\n"),
    ("esc:\n  seen: 1\n", "esc:\n  seen: true\n  kind: fast\n  dwell: 0.3\n"),
], ids=repr)
def test_new_text_has_texts_flags_and_names_that_the_other_one_lacks(before, after):
    values = {"esc/kind": "fast", "esc/seen": True, "esc/dwell": 0.3}
    text = rewritten(before, values, ["head"])
    assert text == rewritten(text, values, ["head"]) == "# head\n\n" + after
    assert {name: yaml.safe_load(text)["esc"][name] for name in ("kind", "seen", "dwell")} == {
        "kind": "fast", "seen": True, "dwell": 0.3}


@pytest.mark.parametrize("before, after", [
    ("# old head\n\n# more of it\na: 1  # old\n\n# about b\nb: 2\n", "a: 9\n\n# about b\nb: 2\n"),
    ("--- \na: 1\nb: 2\n", "a: 9\nb: 2\n"),
    ("b: &n 2\na: 1\nc: *n\n", "b: &n 2\na: 9\nc: *n\n"),
    ("a: &n 1\nb: *n\n", "a: 9\nb: 1\n"),  # what can't be edited
], ids=repr)
def test_new_text_has_another_texts_values_and_a_head_of_its_own(before, after):
    text = rewritten(before, {"a": 9}, ["new head", "", "more"])
    assert text == "# new head\n#\n# more\n\n" + after
    assert yaml.safe_load(text) == {**yaml.safe_load(before), "a": 9}


@pytest.mark.parametrize("text, values, message", [
    ("x: &n 1\ny: *n\n", {"x": 2}, "can't be edited safely"),
    ("node: {a: 1}\n", {"a": 2}, "has none of a"),
    ("a: 1\n", {"a": 1, "servo/neutral": 2}, "lacks it"),
], ids=repr)
def test_file_that_cannot_be_edited_safely_is_refused(text, values, message):
    with pytest.raises(ConfigError, match=message):
        edited(text, values)


NUMBERS = st.integers(0, 65535) | st.floats(0, 65535, allow_nan=False).map(lambda x: round(x, 1))


@settings(max_examples=30)
@given(st.integers(0, 65535), st.lists(NUMBERS, min_size=15, max_size=15))
def test_shipped_steering_file_loads_with_what_was_saved_and_keeps_its_comments(center, table):
    text = (CONFIG / "turn_arb.yaml").read_text(encoding="utf-8")
    values = {"servo_center": center, "k_pwmcmd_left_table_servo": table}
    after = edited(text, values)
    assert yaml.safe_load(after) == {**yaml.safe_load(text), **values}
    assert re.findall("#.*", after) == re.findall("#.*", text)
    assert edited(after, values) == after


# --- the file ---

@pytest.fixture()
def path(tmp_path):
    made = tmp_path / "turn_arb.yaml"
    made.write_text("a: 1  # why\n", encoding="utf-8")
    made.chmod(0o640)
    return made


def test_save_through_a_link_writes_where_it_leads_but_nothing_that_the_file_says_already(path, tmp_path):
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    os.utime(path, (0, 0))
    assert save(str(link), {"a": 1}) is None
    assert path.stat().st_mtime == 0 and set(path.parent.iterdir()) == {path, link}
    save(str(link), {"a": 2})
    assert link.is_symlink() and path.read_text(encoding="utf-8") == "a: 2  # why\n"


def test_write_protected_file_stays_as_it_is_and_one_that_is_not_there_is_named(path):
    path.chmod(0o444)
    with pytest.raises(ConfigError, match=r"can't be saved \(it is write-protected\)"):
        save(str(path), {"servo_center": 5130})
    assert path.read_text(encoding="utf-8") == "a: 1  # why\n" and list(path.parent.iterdir()) == [path]
    with pytest.raises(ConfigError, match=r"nothing\.yaml can't be saved \(No such file or directory\)"):
        save(str(path.parent / "nothing.yaml"), {"a": 2})
