"""Parts of a page in HTML, and texts for numbers and times."""
from __future__ import annotations

import re

import pytest

from car_interface.tools.report.html import (
    MAX_ROWS,
    OPEN_ROWS,
    counted,
    document,
    moment_text,
    range_text,
    span_text,
    table,
)


def test_document_is_a_page_with_an_escaped_title_and_the_body_as_it_is():
    text = document("<b> & co", "<p>body</p>\n")
    assert text.startswith("<!DOCTYPE html>\n<html lang=\"en\">") and text.endswith("</body>\n</html>\n")
    assert "<title>&lt;b&gt; &amp; co</title>" in text
    assert "<main>\n<p>body</p>\n</main>" in text


def test_table_escapes_names_and_takes_cells_as_html():
    text = table(["<n>", "what"], [["<b>1</b>", 2]], numbers=0)
    assert "<th>&lt;n&gt;</th><th>what</th>" in text and "<td><b>1</b></td><td>2</td>" in text


@pytest.mark.parametrize("numbers, numbers_from, expected", [
    (1, None, [True, False, False]), (0, 1, [False, True, True]), (3, 3, [False, False, False]),
])
def test_columns_of_numbers_are_marked_in_head_and_rows(numbers, numbers_from, expected):
    text = table("abc", ["123"], numbers, numbers_from)
    for tag in ("th", "td"):
        cells = re.findall(rf"<{tag}([^>]*)>", text)
        assert cells == [' class="number"' if is_number else "" for is_number in expected]


@pytest.mark.parametrize("rows, folded, shown, more", [
    (0, False, 0, None), (OPEN_ROWS, False, OPEN_ROWS, None), (OPEN_ROWS + 1, True, OPEN_ROWS + 1, None),
    (MAX_ROWS, True, MAX_ROWS, None), (MAX_ROWS + 3, True, MAX_ROWS, "And 3 more."),
])
def test_long_table_is_folded_and_a_very_long_one_ends_early(rows, folded, shown, more):
    text = table(["a"], [["x"]] * rows, numbers=0)
    assert text.count("<td>x</td>") == shown
    assert text.startswith("<details>") == folded and text.endswith("</details>\n") == folded
    if folded:
        assert f"<summary>{rows} lines</summary>" in text
    assert (more in text) if more else "more." not in text


@pytest.mark.parametrize("texts, line", [
    ([], ""), (["a"], "a"), (["a", "b", "b"], "b (2×); a"),
    (["a", "b"], "a; b"),  # the order in which they came, where their numbers are the same
    (list("abcdefgh"), "a; b; c; d; e; f"),
    (list("abcdefghh"), "h (2×); a; b; c; d; e"),
])
def test_texts_are_counted_and_the_six_most_frequent_are_named(texts, line):
    assert counted(iter(texts)) == line


def test_range_has_two_decimals_and_its_unit_and_no_negative_zero():
    assert range_text(-0.5, 12.346, "m/s²") == "-0.50 to 12.35 m/s²"
    assert range_text(-0.001, 1.0, "m/s") == "0.00 to 1.00 m/s"


@pytest.mark.parametrize("time_s, duration_s, text", [
    (7.25, 99.9, "7.25 s"), (0, 0, "0.00 s"), (7.25, 100, "0:07.2"), (187.2, 3600, "3:07.2"),
    (59.96, 3600, "1:00.0"), (3661.0, 7200, "61:01.0"),
])
def test_time_of_a_long_drive_has_minutes(time_s, duration_s, text):
    assert moment_text(time_s, duration_s) == text


@pytest.mark.parametrize("time_s, text", [
    (0.0, "0 s"), (0.0123, "0.012 s"), (0.1, "0.1 s"), (99.94, "99.9 s"), (100, "1 min 40 s"),
    (3599.4, "59 min 59 s"), (3599.6, "1 h 0 min"), (3720, "1 h 2 min"),
])
def test_duration_is_in_seconds_minutes_or_hours(time_s, text):
    assert span_text(time_s) == text
