"""test/mutate.py: which changes there are, how they are found again in edited code, and what kills them."""
from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

TEST = Path(__file__).resolve().parents[1]
sys.path.append(str(TEST))
mutate = importlib.import_module("mutate")
LIST, _ = mutate.from_text((TEST / "mutants/list.txt").read_text(encoding="utf-8"))


def found(code):
    return mutate.find("a.py", code.encode())


def changed(code):
    """Returns the code after each change, by the change."""
    source = code.encode()
    return [(key.change, (source[:place.start] + place.after + source[place.end:]).decode())
            for key, place in found(code).items()]


@pytest.mark.parametrize("code, changes", [
    ("x = a < b", [("compare < → <=", "x = a <= b")]),
    ("x = (a) is not b", [("compare is not → is", "x = (a) is b")]),
    ("x = a if b else c", [("negate", "x = a if not (b) else c")]),
    ("x = not a", [("negate", "x = (a)")]),
    ("x = a and b", [("logic and → or", "x = a or b")]),
    ("x = (ä + b) * -c", [("arithmetic + → -", "x = (ä - b) * -c"), ("arithmetic * → /", "x = (ä + b) / -c"),
                          ("arithmetic - → +", "x = (ä + b) * +c")]),
    ("x = 0xf, 0.0", [("constant 0xf → 16", "x = 16, 0.0"), ("constant 0.0 → 1.0", "x = 0xf, 1.0")]),
    ("x = 0.5, 2000", [("constant 0.5 → 1.0", "x = 1.0, 2000"), ("constant 2000 → 4000", "x = 0.5, 4000")]),
    ("x = True", [("constant True → False", "x = False")]),
    ("x += y", [("arithmetic += → -=", "x -= y")]),
    ("a.x = y", [("drop", "pass")]),
    ("def f():\n  x.stop(\n   y)\n  return x", [("drop", "def f():\n  pass\n  return x"),
                                               ("return None", "def f():\n  x.stop(\n   y)\n  return None")]),
    ("def f():\n  return False", [("constant False → True", "def f():\n  return True")]),
])
def test_code_has_these_changes(code, changes):
    assert changed(code) == changes


@pytest.mark.parametrize("code", [
    '"""A number: 1 < 2."""', "if TYPE_CHECKING:\n  x = 1", '__all__ = [1]', "x: Sequence[1]", "def f(a: 1) -> 2: ...",
    'x = f"{1 + 2}"', 'x = "a" + b', "def f():\n  raise Error(1)", "@cache(1)\ndef f(): ...",
    "def __init__(self):\n  self.x = y", 'status.add("age", 1)', "def main():\n  run(1)",
])
def test_texts_and_what_says_nothing_have_no_changes(code):
    assert not found(code)


def test_mutant_is_found_again_after_edits_elsewhere_and_gone_after_one_of_its_line():
    code = "def f(x):\n  if x > 1:  # far\n    return 1\n"
    (key, *_), edited = found(code), "A = 2\n\n\ndef f(x):\n    y = 3\n    if x > 1:\n        return y\n"
    assert found(edited)[key].lineno == 6
    assert key not in found(code.replace("> 1", "> 2"))


def test_list_is_read_as_it_was_written():
    assert mutate.from_text(mutate.to_text(LIST, {}))[0] == LIST


@pytest.mark.once
def test_mutant_is_killed_by_a_failure_or_a_hang_and_survives_where_nobody_looks(tmp_path, monkeypatch):
    root = tmp_path / "checkout"
    source, test = root / "src/car_interface/steering/a.py", root / "test/unit/steering/test_a.py"
    for path in (source, test):
        path.parent.mkdir(parents=True)
    source.write_text("def f(n):\n  while n > 0:\n    n -= 1\n  return n\n\ndef g():\n  return 5\n")
    test.write_text("from car_interface.steering.a import f\n\ndef test_f():\n  assert f(3) == 0\n")
    monkeypatch.setattr(mutate, "LIMIT_EXTRA_S", 2.0)
    for name in [name for name in sys.modules if name.partition(".")[0] == "car_interface"]:
        monkeypatch.delitem(sys.modules, name)  # of other tests in this process, which the runs of the mutants fork
    keys = list(mutate.find("steering/a.py", source.read_bytes()))
    gone = keys[0]._replace(line="while n > 1:")
    slots = [mutate.Slot(root, tmp_path / "slot")]
    ((module, survivors, places),) = mutate.run_mutants(root, slots, {"steering/a.py": [*keys, gone]})
    assert module == "steering/a.py" and set(places) == set(keys)
    assert [(key.function, key.change) for key in survivors] == [("g", "return None"), ("g", "constant 5 → 6")]
