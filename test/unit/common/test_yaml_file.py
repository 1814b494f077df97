"""The YAML files that are read, and those that are refused before anything is built of them, in one line."""
from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import edited, rewritten, save
from car_interface.common.yaml_file import MAX_BYTES, compose_yaml, load_yaml, scalar_number

CONFIG = Path(__file__).resolve().parents[3] / "config"


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.name)
def test_shipped_file_is_read_as_yaml_has_it(path):
    assert load_yaml(str(path)) == yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("text", [
    pytest.param("a: 0x40\nb: 1e-3\nc: 010\nd: 12:30\ne: on\nf: 1_0\n", id="yaml_1.1_as_ros_reads_it"),
    pytest.param("a: &n [1, 2]\nb: *n\nc: {x: *n, y: *n}\n", id="list_that_others_refer_to"),
    pytest.param("a: &n {x: 1}\nb: {<<: *n, y: 2}\nc: {<<: *n, x: 3}\n", id="mapping_that_others_extend"),
    pytest.param("a: {x: 1}\nb: {x: 1}\n", id="name_in_two_mappings"),
    pytest.param("a: [1, {x: 1}, {x: 1}]\n", id="name_in_two_mappings_of_a_list"),
    pytest.param("\ufeffa: 1\r\nb: 2\r\n", id="byte_order_mark_and_windows_line_ends"),
    pytest.param("a: " + "[" * 99 + "1" + "]" * 99, id="100_levels"),
    pytest.param("# " + "x" * (MAX_BYTES - 8) + "\na: 1\n", id="1_mb"),
    pytest.param("\n".join(f"name{index}: {index}" for index in range(5_000)), id="a_great_many_values"),
])
def test_ordinary_file_is_read(text, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(text.encode("utf-8"))
    assert load_yaml(str(path)) == yaml.safe_load(text)


def multiplied(levels, width=9):
    """Aliases of aliases: width ** levels values."""
    return "a0: &a0 [1]\n" + "".join(
        f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * width)}]\n" for level in range(1, levels + 1))


HOSTILE = [
    pytest.param(multiplied(5), "line 6 makes more than 100,000 values by its aliases; accepted: aliases for at most "
                                "100,000", id="aliases_of_aliases"),
    pytest.param(multiplied(9), "more than 100,000 values by its aliases", id="billion_laughs"),
    pytest.param("a0: &a0 {x: 1}\n" + "".join(
        f"a{level}: &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}\n" for level in range(1, 10)),
        "more than 100,000 values by its aliases", id="mappings_that_extend_each_other"),
    pytest.param("a: [&a0 [1], " + ", ".join(f"&a{level} [*a{level - 1}]" for level in range(1, 300)) + "]\n",
                 "nested more than 100 levels deep", id="levels_by_aliases"),
    pytest.param("a: &n [1, *n]\n", r"line 1 has \*n inside of what it stands for; accepted: aliases of values that",
                 id="list_in_itself"),
    pytest.param("a: 1\nb: &n\n  c: {d: [*n]}\n", r"line 3 has \*n inside of what it stands", id="mapping_in_itself"),
    pytest.param("a: &n {<<: *n}\n", r"line 1 has \*n inside", id="mapping_that_extends_itself"),
    pytest.param("a: " + "[" * 100 + "1" + "]" * 100, "line 1 is nested more than 100 levels deep; accepted: at",
                 id="101_levels"),
    pytest.param("a: " + "[" * 3000 + "]" * 3000, "more than 100 levels deep", id="3000_lists"),
    pytest.param("a: " + "{a: " * 3000 + "1" + "}" * 3000, "more than 100 levels deep", id="3000_mappings"),
    pytest.param("a:\n" + "- " * 3000 + "1\n", "line 2 is nested more than 100 levels deep", id="3000_dashes"),
    pytest.param("".join(" " * level + "a:\n" for level in range(1000)) + " " * 1000 + "1",
                 "line 101 is nested more than 100 levels deep", id="1000_lines"),
    pytest.param("[" * 900_000, "more than 100 levels deep", id="nothing_but_brackets"),
    pytest.param("a: 1\nb: 2\na: 3\n", "lines 1 and 3 both give a; accepted: each name once", id="name_twice"),
    pytest.param("s:\n  a: 1\n  'a': 2\n", "lines 2 and 3 both give a", id="name_twice_inside_and_quoted"),
    pytest.param("l:\n- {a: 1, b: 2, a: 1}\n", "line 2 gives a twice", id="name_twice_on_a_line"),
    pytest.param("a: " + "1" * 101 + "\n", "line 1 has a number of 101 digits; accepted: at most", id="long_number"),
    pytest.param("x: 0\na: " + "1:" * 100_000 + "1.5\n", "line 2 has a number of 200003 digits", id="long_base_60"),
    pytest.param("a: !!int '" + "9" * 5000 + "'\n", "has a number of 5000 digits", id="long_number_by_a_tag"),
    pytest.param("a: !!bool perhaps\n", "line 1 is no YAML: perhaps is no bool; accepted: parameters in YAML",
                 id="no_flag"),
    pytest.param("\na: !!timestamp x\n", "line 2 is no YAML: x is no timestamp", id="no_time"),
    pytest.param("a: 2026-13-45\n", "line 1 is no YAML: 2026-13-45 is no timestamp", id="no_date"),
    pytest.param("a: !!python/object/apply:os.system ['true']\n", "line 1 is no YAML: .*python/object", id="program"),
    pytest.param("? [a]\n: 1\n", "line 1 is no YAML: .*unhashable", id="list_as_a_name"),
    pytest.param("a: *n\n", "line 1 is no YAML: found undefined alias 'n'", id="alias_of_nothing"),
    pytest.param("a: 1\nb: [1,\n", "line 3 is no YAML: while parsing a flow", id="unfinished"),
    pytest.param("a: 1\n---\na: 1\n", "line 2 is no YAML: expected a single document", id="two_documents"),
    pytest.param("a: 1\nb: \0\n", r"line 2 is no YAML: U\+0000 is no character of a text", id="zero_byte"),
    pytest.param("- 1\n", "has no such lines; accepted: YAML lines of a parameter's name, a colon", id="list"),
    pytest.param("12\n", "has no such lines", id="number"),
    pytest.param("", "has no such lines", id="empty"),
    pytest.param("# " + "x" * MAX_BYTES + "\na: 1\n", r"can't be read \(it has 1.0 MB, more than 1 MB\)",
                 id="too_large"),
    pytest.param(b"a: 1\nb: \xff\n", "line 2 is no text in UTF-8", id="latin"),
]


@pytest.mark.parametrize("text, message", HOSTILE)
def test_hostile_file_is_refused_in_one_line(text, message, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    with pytest.raises(ConfigError, match=message) as caught:
        load_yaml(str(path))
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert "; accepted: " in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize("text, message", [case for case in HOSTILE if case.id not in (
    "no_flag", "no_time", "no_date", "program", "list_as_a_name")])  # which are not built where only others are edited
def test_hostile_file_is_not_saved_to(text, message, tmp_path):
    path = tmp_path / "a.yaml"
    before = text if isinstance(text, bytes) else text.encode("utf-8")
    path.write_bytes(before)
    with pytest.raises(ConfigError, match=message.replace("can't be read", "can't be saved")) as caught:
        save(str(path), {"a": 5})
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("scalar", ["[" * 3000, "&a [*a]", "{a: &a {a: *a}}", "9" * 5000, "*x", "!!bool x"],
                         ids=["brackets", "list_in_itself", "mapping_in_itself", "digits", "alias", "tag"])
def test_text_in_quotes_is_not_read_as_yaml_once_more(scalar):
    assert scalar_number(scalar) is None
    assert edited(f"a: 1\nb: '{scalar}'\n", {"a": 2}) == f"a: 2\nb: '{scalar}'\n"


def test_mapping_has_no_number():
    assert edited("a: {b: 1}\n", {"a": 2}) == "a: 2\n"


def test_new_text_after_a_hostile_one_is_refused():
    with pytest.raises(ConfigError, match=r"base\.yaml, lines 1 and 2 both give a"):
        rewritten("a: 1\na: 2\n", {"a": 3}, [], "base.yaml")


@pytest.mark.parametrize("make, reason", [
    pytest.param(lambda path: os.mkfifo(str(path)), "it is a pipe", id="pipe"),
    pytest.param(lambda path: path.symlink_to("/dev/zero"), "it is a device", id="device"),
    pytest.param(lambda path: path.mkdir(), "Is a directory", id="folder"),
    pytest.param(lambda path: socket.socket(socket.AF_UNIX).bind(str(path)), "it is a socket", id="socket"),
])
def test_what_is_no_file_is_neither_read_nor_saved_to(make, reason, tmp_path):
    path = tmp_path / "a.yaml"
    make(path)
    with pytest.raises(ConfigError, match=rf"a\.yaml can't be read \({reason}\); accepted: a file that can be read"):
        load_yaml(str(path))
    with pytest.raises(ConfigError, match=rf"can't be saved \({reason}\)"):
        save(str(path), {"a": 1})
    assert list(tmp_path.iterdir()) == [path]


@given(st.text(st.sampled_from("a:1[]{}&*, \n-'\"!<|>?#%"), max_size=40) | st.text(max_size=20))
@example("a: &a\n  b: *a")
@example("? ? ?")
@example("<<: 1")
@example("a: ! b")
def test_text_of_any_kind_is_read_as_yaml_has_it_or_refused(text):
    try:
        found = load_yaml("a.yaml", text)
    except ConfigError as error:
        assert "\n" not in str(error)
        return
    assert repr(found) == repr(yaml.safe_load(text))
    compose_yaml(text, "a.yaml")


@pytest.mark.parametrize("text, number", [
    ("12", 12), ("0x0A", 10), ("010", 8), ("1.5", 1.5), ("1e3", 1000.0), ("12:30", 750), ("1_0", 10),
    (".inf", float("inf")), (".nan", None), ("true", None), ("~", None), ("2026-01-01", None), ("'1_0'", None),
    ("1_0e1", None), ("١٢", None), ("", None),
])
def test_scalar_is_the_number_that_the_parameter_server_and_the_node_make_of_it(text, number):
    assert scalar_number(text) == number
