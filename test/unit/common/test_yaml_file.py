"""The YAML files that are read, and those that are refused before anything is built of them, in one line."""
import os

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from car_interface.common.errors import ConfigError
from car_interface.common.yaml_edit import edited, rewritten, save
from car_interface.common.yaml_file import MAX_BYTES, compose_yaml, load_yaml, scalar_number


@pytest.mark.parametrize("text", [
    "a: 0x40\nb: 1e-3\nc: 010\nd: 12:30\ne: on\nf: 1_0\n",
    "a: &n [1, 2]\nb: *n\nc: {x: *n, y: *n}\n",
    "a: &n {x: 1}\nb: {<<: *n, y: 2}\nc: {<<: *n, x: 3}\n",
    "\ufeffa: 1\r\nb: 2\r\n",
    "a: " + "[" * 99 + "1" + "]" * 99,
    "# " + "x" * (MAX_BYTES - 8) + "\na: 1\n",
    "\n".join(f"name{index}: {index}" for index in range(1_000)),
], ids=lambda text: repr(text[:40]))
def test_ordinary_file_is_read(text, tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(text.encode("utf-8"))
    assert load_yaml(str(path)) == yaml.safe_load(text)


def multiplied(levels, width=9):
    """Aliases of aliases: width ** levels values."""
    return "a0: &a0 [1]\n" + "".join(
        f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * width)}]\n" for level in range(1, levels + 1))


DEEP, MANY, NO_TIME = "nested more than 100 levels deep", "more than 100,000 values by its aliases", "is no timestamp"
HOSTILE = [
    (multiplied(5), f"line 6 makes {MANY}; accepted: aliases for at most 100,000"),
    ("a0: &a0 {x: 1}\n" + "".join(f"a{level}: &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}\n"
                                  for level in range(1, 10)), MANY),
    ("a: [&a0 [1], " + ", ".join(f"&a{level} [*a{level - 1}]" for level in range(1, 300)) + "]\n", DEEP),
    ("a: &n [1, *n]\n", r"line 1 has \*n inside of what it stands for; accepted: aliases of values that"),
    ("a: 1\nb: &n\n  c: {d: [*n]}\n", r"line 3 has \*n inside of what it stands"),
    ("a: " + "[" * 100 + "1" + "]" * 100, f"line 1 is {DEEP}; accepted: at"),
    ("".join(" " * level + "a:\n" for level in range(1000)) + " " * 1000 + "1", f"line 101 is {DEEP}"),
    ("[" * 900_000, DEEP),
    ("a: 1\nb: 2\na: 3\n", "lines 1 and 3 both give a; accepted: each name once"),
    ("l:\n- {a: 1, b: 2, a: 1}\n", "line 2 gives a twice"),
    ("a: " + "1" * 101 + "\n", "line 1 has a number of 101 digits; accepted: at most"),
    ("x: 0\na: " + "1:" * 100_000 + "1.5\n", "line 2 has a number of 200003 digits"),
    ("a: *n\n", "line 1 is no YAML: found undefined alias 'n'"),
    ("a: 1\nb: [1,\n", "line 3 is no YAML: while parsing a flow"),
    ("a: 1\n---\na: 1\n", "line 2 is no YAML: expected a single document"),
    ("a: 1\nb: \0\n", r"line 2 is no YAML: U\+0000 is no character of a text"),
    ("- 1\n", "has no such lines; accepted: YAML lines of a parameter's name, a colon"),
    ("", "has no such lines"),
    ("# " + "x" * MAX_BYTES + "\na: 1\n", r"can't be read \(it has 1.0 MB, more than 1 MB\)"),
    (b"a: 1\nb: \xff\n", "line 2 is no text in UTF-8"),
]
NOT_BUILT = [  # where only other values are edited
    ("a: !!bool perhaps\n", "line 1 is no YAML: perhaps is no bool; accepted: parameters in YAML"),
    ("a: 2026-13-45\n", f"line 1 is no YAML: 2026-13-45 {NO_TIME}"),
    ("a: !!python/object/apply:os.system ['true']\n", "line 1 is no YAML: .*python/object"),
    ("? [a]\n: 1\n", "line 1 is no YAML: .*unhashable"),
]


@pytest.mark.parametrize("text, message, is_built", [*((*case, True) for case in HOSTILE),
                                                     *((*case, False) for case in NOT_BUILT)],
                         ids=lambda value: repr(value[:40]) if isinstance(value, (str, bytes)) else None)
def test_hostile_file_is_refused_in_one_line_and_not_saved_to(text, message, is_built, tmp_path):
    path = tmp_path / "a.yaml"
    before = text if isinstance(text, bytes) else text.encode("utf-8")
    path.write_bytes(before)
    with pytest.raises(ConfigError, match=message) as caught:
        load_yaml(str(path))
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert "; accepted: " in str(caught.value) and len(str(caught.value)) < 400
    if is_built:
        with pytest.raises(ConfigError, match=message.replace("can't be read", "can't be saved")) as caught:
            save(str(path), {"a": 5})
        assert "\n" not in str(caught.value)
        assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("scalar", ["[" * 3000, "&a [*a]", "{a: &a {a: *a}}", "9" * 5000, "*x", "!!bool x"],
                         ids=lambda scalar: scalar[:20])
def test_text_in_quotes_is_not_read_as_yaml_once_more(scalar):
    assert scalar_number(scalar) is None
    assert edited(f"a: 1\nb: '{scalar}'\n", {"a": 2}) == f"a: 2\nb: '{scalar}'\n"


def test_new_text_after_a_hostile_one_is_refused():
    with pytest.raises(ConfigError, match=r"base\.yaml, lines 1 and 2 both give a"):
        rewritten("a: 1\na: 2\n", {"a": 3}, [], "base.yaml")


@pytest.mark.parametrize("make, reason", [(lambda path: os.mkfifo(str(path)), "it is a pipe"),
                                          (lambda path: path.mkdir(), "Is a directory")])
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
