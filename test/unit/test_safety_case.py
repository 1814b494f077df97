"""test/safety_case.py: what ``./dev lint`` refuses of the safety case."""
import pytest
import safety_case
from safety_case import DATA, PAGE, faults, load, page

TEXT = DATA.read_text(encoding="utf-8")


def test_table_has_no_faults_and_is_the_page():
    case = load(TEXT)
    assert faults(case) == []
    assert page(case) == PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("old, new, found", [
    ("::test_time_from_fault_to_neutral", "::test_time", "chain: test/graph/test_chain.py has no test_time_is_that_of"),
    ("graph/test_chain.py::test_clock", "graph/test_gone.py::test_clock", "clock: there is no test/graph/test_gone.py"),
    ("    tests: [first_steer, first_pull, override_pull]", "    tests: []", "G4 has no test"),
    ("`board silent`", "nothing", "cause 'board silent' has no row"),
    ("topics: [/servo/output]", "topics: []", "topic /servo/output has no row"),
    ("nodes: [pca9685]", "nodes: []", "node pca9685 has no row"),
    ("devices: [sonars]", "devices: []", "device 'sonars' has no row"),
    ("[frozen, stuck value], \"the deadman", "[frozen], \"the deadman", "Gamepad: no row for stuck value"),
    ("common/staleness,", "common/freshness,", "Any topic, stalled: there is no module common/freshness"),
    ("[R1, R3, R6]", "[R99]", "The deadman's message, stuck value: there is no risk R99"),
    ("\"none but OE\", \"\", [], [R2]", "\"none but OE\", \"\", [], []",
     "Computer, dead, frozen, no power: it has neither mechanism and test nor a residual risk"),
    ("\"if foreign:\"", "\"if strange:\"", "switched off: 'if strange:' stands 0 times in pca9685/board"),
    ("[board_two]]", "[board_twos]]", "switched off: tests lacks board_twos"),
    ("[battery_odd]]", "[battery_empty]]",
     "The battery's voltage, dead, corrupted: nothing switches throttle/battery off for one of its tests"),
])
def test_fault_of_the_table_is_named(old, new, found):
    assert old in TEXT
    assert any(line.startswith(found) for line in faults(load(TEXT.replace(old, new, 1))))


def test_stale_page_fails_and_is_written_anew(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(safety_case, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr("sys.argv", ["safety_case.py", "--check"])
    assert safety_case.main() == 1
    assert "is stale: python3 test/safety_case.py" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["safety_case.py"])
    assert safety_case.main() == 0
    assert safety_case.PAGE.read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")
