"""Values saved back to YAML: what changes in the file, what does not, and when nothing is touched at all."""
from __future__ import annotations

import os
import re
import stat
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.common import atomic_file
from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import edited, rewritten, save

CONFIG = Path(__file__).resolve().parents[3] / "config"


@pytest.mark.parametrize("before, values, after", [
    pytest.param("a: 1  # why\nb: 2\n", {"a": 5}, "a: 5  # why\nb: 2\n", id="comment_on_the_line_stays"),
    pytest.param("# head\n\nb:   2\na:    1\n", {"a": 10}, "# head\n\nb:   2\na:    10\n", id="blanks_and_order_stay"),
    pytest.param("a: 1\r\nb: 2\r\n", {"a": 5}, "a: 5\r\nb: 2\r\n", id="windows_line_ends_stay"),
    pytest.param("\ufeffa: 1\n", {"a": 5}, "\ufeffa: 5\n", id="byte_order_mark_stays"),
    pytest.param("ä: 'ö'\na: 1\n", {"a": 5}, "ä: 'ö'\na: 5\n", id="letters_beyond_ascii_before_it"),
    pytest.param("a: 1", {"a": 5}, "a: 5", id="no_line_end_at_the_end"),
    pytest.param("a: 0x0A\n", {"a": 10}, "a: 0x0A\n", id="same_value_in_another_spelling_is_left_alone"),
    pytest.param("a: 1e1\n", {"a": 10}, "a: 1e1\n", id="exponent_that_yaml_takes_for_a_text"),
    pytest.param("a: 10.0\n", {"a": 10}, "a: 10.0\n", id="float_of_the_same_value"),
    pytest.param("a: 1\n", {"a": 2.5}, "a: 2.5\n", id="fraction"),
    pytest.param("a: 1\n", {"a": 2.0}, "a: 2\n", id="float_without_a_fraction_is_written_short"),
    pytest.param("a: '1'\n", {"a": 2}, "a: 2\n", id="quoted_number"),
    pytest.param("a: true\n", {"a": 1}, "a: 1\n", id="true_is_no_number"),
    pytest.param("servo:\n  neutral: 4915  # 1.5 ms\n  channel: 1\n", {"servo/neutral": 4950},
                 "servo:\n  neutral: 4950  # 1.5 ms\n  channel: 1\n", id="value_inside_a_mapping"),
    pytest.param("servo: {neutral: 1, x: [1, 2]}\n", {"servo/neutral": 2, "servo/x": [1, 3]},
                 "servo: {neutral: 2, x: [1, 3]}\n", id="mapping_on_one_line"),
    pytest.param("t: [5100, 0,  0]  # first one steers\n", {"t": [5150, 0, 0]},
                 "t: [5150, 0,  0]  # first one steers\n", id="one_element_of_a_list"),
    pytest.param("t: [0x0A, 1]\n", {"t": [10, 2]}, "t: [0x0A, 2]\n", id="element_in_another_spelling_is_left_alone"),
    pytest.param("t:\n- 1  # one\n- 2\n", {"t": [1, 3]}, "t:\n- 1  # one\n- 3\n", id="list_on_several_lines"),
    pytest.param("t: [1, 2]\n", {"t": [1, 2, 3]}, "t: [1, 2, 3]\n", id="list_that_grows"),
    pytest.param("t: 5\n", {"t": [5, 5]}, "t: 5\n", id="one_number_stands_for_a_list_of_equal_ones"),
    pytest.param("t: 5  # all\n", {"t": [6, 5]}, "t: [6, 5]  # all\n", id="one_number_that_no_longer_can"),
    pytest.param("a: 1\n", {"a": 1, "b": 2}, "a: 1\nb: 2\n", id="missing_name_goes_to_the_end"),
    pytest.param("a: 1", {"a": 1, "b": [2, 3]}, "a: 1\nb: [2, 3]\n", id="missing_name_behind_a_line_without_end"),
    pytest.param("b: !degrees 3\nc: deg(90)\nd: .nan\na: 1\n", {"a": 2}, "b: !degrees 3\nc: deg(90)\nd: .nan\na: 2\n",
                 id="what_only_rosparam_understands_stays"),
    pytest.param("c: deg(90)\nd: .nan\ne: 2026-01-01\nf: ~\na: 1\n", {"a": 2},
                 "c: deg(90)\nd: .nan\ne: 2026-01-01\nf: ~\na: 2\n", id="odd_values_beside_it_stay"),
    pytest.param("x: &n 3\ny: *n\na: 1\n", {"a": 2}, "x: &n 3\ny: *n\na: 2\n", id="anchor_elsewhere_stays"),
])
def test_only_what_differs_is_rewritten(before, values, after):
    assert edited(before, values) == after

@pytest.mark.parametrize("before, values, after", [
    pytest.param("a: 1  # one\nb: 2  # two\n", {"a": 5}, "a: 5\nb: 2  # two\n", id="comment_behind_a_changed_value"),
    pytest.param("a: 1  # one\n", {"a": 1}, "a: 1  # one\n", id="comment_behind_an_unchanged_value"),
    pytest.param("t: [1, 2]  # both\n", {"t": [1, 3]}, "t: [1, 3]\n", id="comment_behind_a_list"),
    pytest.param("t:\n- 1  # one\n- 2  # two\n", {"t": [1, 3]}, "t:\n- 1  # one\n- 3\n",
                 id="comment_behind_an_element"),
    pytest.param("# on a line of its own\na: 1\n", {"a": 2}, "# on a line of its own\na: 2\n", id="line_of_its_own"),
])
def test_comments_behind_changed_values_are_removed_on_request(before, values, after):
    assert edited(before, values, keeps_comments=False) == after


@pytest.mark.parametrize("before, after", [
    pytest.param("# the kind\nesc:\n  kind: none  # as yet\nb: 2\n",
                 "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\nb: 2\n", id="mapping_that_lacks_some"),
    pytest.param("esc:\n    kind: none\n    x: 1  # one\n\n# about b\nb: 2",
                 "esc:\n    kind: fast\n    x: 1  # one\n    seen: true\n    dwell: 0.3\n\n# about b\nb: 2",
                 id="behind_the_last_of_the_mapping"),
    pytest.param("esc:\n  t: [1,\n      2]\n  kind: none\n  s:\n  - 1\nb: 2\n",
                 "esc:\n  t: [1,\n      2]\n  kind: fast\n  s:\n  - 1\n  seen: true\n  dwell: 0.3\nb: 2\n",
                 id="mapping_that_ends_with_a_list"),
    pytest.param("esc:\n  kind: none", "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3", id="no_line_end"),
    pytest.param("b: 2\n", "b: 2\nesc:\n  kind: fast\n  seen: true\n  dwell: 0.3\n", id="no_mapping"),
    pytest.param("esc: {kind: fast}\nb: 2\n", "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\nb: 2\n",
                 id="mapping_on_one_line_is_written_anew"),
    pytest.param("esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\n", "esc:\n  kind: fast\n  seen: true\n  dwell: 0.3\n",
                 id="nothing_changes"),
    pytest.param("esc:\n  seen: 1\n", "esc:\n  seen: true\n  kind: fast\n  dwell: 0.3\n", id="true_is_not_1"),
])
def test_new_text_has_texts_flags_and_names_that_the_other_one_lacks(before, after):
    values = {"esc/kind": "fast", "esc/seen": True, "esc/dwell": 0.3}
    text = rewritten(before, values, ["head"])
    assert text == "# head\n\n" + after
    assert {name: yaml.safe_load(text)["esc"][name] for name in ("kind", "seen", "dwell")} == {
        "kind": "fast", "seen": True, "dwell": 0.3}


@pytest.mark.parametrize("before, after", [
    pytest.param("# old head\n\n# more of it\na: 1  # old\n\n# about b\nb: 2\n", "a: 9\n\n# about b\nb: 2\n",
                 id="head_is_replaced_and_other_comments_stay"),
    pytest.param("{a: 1, b: 2}\n", "{a: 9, b: 2}\n", id="mapping_on_one_line"),
    pytest.param("--- \na: 1\nb: 2\n", "a: 9\nb: 2\n", id="document_start"),
    pytest.param("b: &n 2\na: 1\nc: *n\n", "b: &n 2\na: 9\nc: *n\n", id="anchor_elsewhere"),
    pytest.param("a: &n 1\nb: *n\n", "a: 9\nb: 1\n", id="what_cannot_be_edited_is_written_anew"),
])
def test_new_text_has_another_texts_values_and_a_head_of_its_own(before, after):
    text = rewritten(before, {"a": 9}, ["new head", "", "more"])
    assert text == "# new head\n#\n# more\n\n" + after
    assert yaml.safe_load(text) == {**yaml.safe_load(before), "a": 9}


def test_new_text_after_what_is_no_mapping_is_refused():
    with pytest.raises(ConfigError, match=r"base\.yaml has no such lines"):
        rewritten("- 1\n", {"a": 2}, [], "base.yaml")


@pytest.mark.parametrize("text, values, message", [
    pytest.param("x: &n 1\ny: *n\n", {"x": 2}, "can't be edited safely", id="value_that_another_one_refers_to"),
    pytest.param("x: &n 1\ny: *n\n", {"y": 2}, "can't be edited safely", id="value_that_refers_to_another_one"),
    pytest.param("b: 1\n", {"a": 2}, "has none of a", id="file_of_something_else"),
    pytest.param("node: {a: 1}\n", {"a": 2}, "has none of a", id="values_one_level_too_deep"),
    pytest.param("a: 1\n", {"a": 1, "servo/neutral": 2}, "lacks it", id="missing_mapping"),
    pytest.param("- 1\n", {"a": 2}, "has no such lines", id="list"),
    pytest.param("", {"a": 2}, "has no such lines", id="empty"),
    pytest.param("a: [1\n", {"a": 2}, "is no YAML", id="unfinished"),
    pytest.param("a: 1\n---\na: 2\n", {"a": 2}, "is no YAML", id="two_documents"),
    pytest.param("a: 1\nb: \x00\n", {"a": 2}, "is no YAML", id="zero_byte"),
    pytest.param("a: 1\na: 2\n", {"a": 3}, "lines 1 and 2 both give a", id="name_that_comes_twice"),
])
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


def test_save_replaces_the_file_and_keeps_the_old_one_beside_it_with_the_time(path):
    aside = Path(save(str(path), {"a": 2}))
    assert path.read_text(encoding="utf-8") == "a: 2  # why\n"
    assert aside.read_text(encoding="utf-8") == "a: 1  # why\n"
    assert re.fullmatch(r"turn_arb\.yaml\.bak-\d{8}-\d{6}", aside.name) and aside.parent == path.parent
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(aside.stat().st_mode) == 0o640
    assert sorted(path.parent.iterdir()) == [path, aside]


def test_saves_within_a_second_keep_every_old_file(path):
    asides = {save(str(path), {"a": value}) for value in range(2, 8)}
    assert len(asides) == 6
    assert sorted(Path(aside).read_text(encoding="utf-8") for aside in asides) == [
        f"a: {value}  # why\n" for value in range(1, 7)]


def test_save_of_what_the_file_says_already_writes_nothing(path):
    os.utime(path, (0, 0))
    assert save(str(path), {"a": 1}) is None
    assert path.stat().st_mtime == 0 and list(path.parent.iterdir()) == [path]


def test_save_through_a_link_writes_where_it_leads_and_leaves_the_link(path, tmp_path):
    link = tmp_path / "link.yaml"
    link.symlink_to(path)
    save(str(link), {"a": 2})
    assert link.is_symlink() and path.read_text(encoding="utf-8") == "a: 2  # why\n"


def test_write_protected_file_stays_as_it_is(path):
    path.chmod(0o444)
    before = path.read_bytes()
    with pytest.raises(ConfigError, match=r"can't be saved \(it is write-protected\)"):
        save(str(path), {"servo_center": 5130})
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


def test_save_to_a_file_that_is_not_there_names_it(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.yaml can't be saved \(No such file or directory\)"):
        save(str(tmp_path / "nothing.yaml"), {"a": 2})


def test_save_to_what_is_no_text_names_it(path):
    path.write_bytes(b"a: \xff\n")
    with pytest.raises(ConfigError, match="is no text in UTF-8"):
        save(str(path), {"a": 2})


def test_save_that_fails_half_way_leaves_the_file_as_it_was_and_nothing_beside_it(path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match=r"can't be saved \(No space left on device\)"):
        save(str(path), {"a": 2})
    assert path.read_text(encoding="utf-8") == "a: 1  # why\n" and list(path.parent.iterdir()) == [path]


def test_file_that_cannot_be_backed_up_stays(path, monkeypatch):
    def refused(_):
        raise PermissionError(13, "Permission denied")
    monkeypatch.setattr(atomic_file, "_back_up", refused)
    with pytest.raises(ConfigError, match=r"can't be saved \(Permission denied\)"):
        save(str(path), {"a": 2})
    assert list(path.parent.iterdir()) == [path]
