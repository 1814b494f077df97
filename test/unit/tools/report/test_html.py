"""Texts for numbers and times."""
import pytest

from car_interface.tools.report.html import breakable, counted, moment_text, span_text


@pytest.mark.parametrize("texts, line", [
    ([], ""), (["a"], "a"), (["a", "b", "b"], "b (2×); a"),
    (["a", "b"], "a; b"),  # the order in which they came, where their numbers are the same
    (list("abcdefgh"), "a; b; c; d; e; f"),
    (list("abcdefghh"), "h (2×); a; b; c; d; e"),
])
def test_texts_are_counted_and_the_six_most_frequent_are_named(texts, line):
    assert counted(iter(texts)) == line


@pytest.mark.parametrize("text, html", [
    ("/camera/depth_raw", "/camera/<wbr>depth_<wbr>raw"), ("~/car/a.bag", "~/car/<wbr>a.bag"),
    ("__name_", "__name_"), ("a _ b", "a _ b"), ("</b_c>", "&lt;/b_<wbr>c&gt;"), ("a/&<i>", "a/&amp;&lt;i&gt;")])
def test_long_name_may_break_behind_its_parts_and_stays_text(text, html):
    assert breakable(text) == html


@pytest.mark.parametrize("time_s, duration_s, text", [
    (7.25, 99.9, "7.25 s"), (0, 0, "0.00 s"), (7.25, 100, "0:07.2"), (187.2, 3600, "3:07.2"),
    (59.96, 3600, "1:00.0"), (3661.0, 7200, "61:01.0"),
])
def test_time_of_a_long_drive_has_minutes(time_s, duration_s, text):
    assert moment_text(time_s, duration_s) == text


@pytest.mark.parametrize("time_s, text", [
    (-5.0, "unknown"), (0.0, "0 s"), (4.3e-06, "<0.01 s"), (0.0123, "0.01 s"), (0.0949, "0.09 s"),
    (0.095, "0.1 s"), (99.94, "99.9 s"), (99.96, "1 min 40 s"), (100, "1 min 40 s"),
    (3599.4, "59 min 59 s"), (3599.6, "1 h 0 min"), (3720, "1 h 2 min"),
])
def test_duration_is_in_seconds_minutes_or_hours_and_a_moment_has_no_digits(time_s, text):
    assert span_text(time_s) == text
