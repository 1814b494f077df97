"""test/tally.py: what the results in a step's folder count as."""
import pytest
from tally import Tally, tally

PASSED = '<testcase classname="a.B" name="passes"/>'
FAILED = '<testcase classname="a.B" name="fails"><failure message="1 is not 2&#10;more">text</failure></testcase>'
ERROR = '<testcase name="crashes"><error>no message\nbut text</error></testcase>'
SKIPPED = '<testcase name="skips"><skipped/></testcase>'


@pytest.fixture
def step(tmp_path):
    folder = tmp_path / "turn_arb.test"
    folder.mkdir()

    def write(**files):
        for name, text in files.items():
            path = folder / name.replace("_xml", ".xml").replace("rostest_", "rostest-")
            path.write_text(f"<testsuite>{''.join(text)}</testsuite>" if path.suffix else text, encoding="utf-8")
        return tally(folder)
    return write


@pytest.mark.parametrize("files, expected", [
    ({"junit_xml": [PASSED, FAILED, ERROR, SKIPPED], "exit_code": "1"},
     Tally(1, ("turn_arb.test: a.B.fails: 1 is not 2", "turn_arb.test: crashes: no message"), 1)),
    ({"one_xml": [PASSED], "two_xml": [PASSED], "rostest_two_xml": [PASSED], "exit_code": "0"}, Tally(2)),
    ({"rostest_two_xml": [FAILED], "exit_code": "1"}, Tally(0, ("turn_arb.test: a.B.fails: 1 is not 2",))),
    ({"one_xml": [PASSED, PASSED], "skipped": "a: why\n", "exit_code": "0"}, Tally(1, (), 1)),
    ({"exit_code": "124", "one_xml": [FAILED], "why_ended": "hung: ended after 9 s"},
     Tally(0, ("turn_arb.test: a.B.fails: 1 is not 2", "turn_arb.test: hung: ended after 9 s"))),
], ids=["each_outcome", "passes_of_rostest_itself_do_not_count", "failures_of_rostest_itself_do",
        "rosunit_s_passes_that_were_skipped", "hung_after_a_failure"])
def test_what_a_step_s_files_count_as(step, files, expected):
    assert step(**files) == expected


@pytest.mark.parametrize("files, failure", [
    ({"exit_code": "0"}, "no test ran"),
    ({"exit_code": "139", "one_xml": [PASSED]}, "ended with exit code 139 without a failed test"),
    ({"exit_code": "124", "one_xml": ["<cut"], "why_ended": "hung: ended after 9 s"}, "hung: ended after 9 s"),
    ({"exit_code": "0", "one_xml": [PASSED], "left_behind": "2"}, "left 2 processes behind"),
    ({"exit_code": "1", "one_xml": ["<cut"]}, "its result file one.xml is no XML"),
], ids=["no_test", "crash", "time_limit_and_incomplete_file", "left_behind", "incomplete_file"])
def test_what_went_wrong_without_a_failed_test_is_a_failure(step, files, failure):
    (found,) = step(**files).failures
    assert found.startswith(f"turn_arb.test: {failure}")


def test_sum_adds_everything_and_is_the_last_line():
    total = Tally.sum([Tally(2, ("a: b",), 1), Tally(3), Tally(skipped=1)])
    assert (str(total), total.lines()) == ("5 passed, 1 failed, 2 skipped", ["FAILED a: b"])
    assert Tally.sum([]) == Tally()
