"""The page about a drive."""
from __future__ import annotations

import copy
import re
from html import unescape
from html.parser import HTMLParser
from types import SimpleNamespace

import pytest

from car_interface.tools.recordings.recording import Topic
from car_interface.tools.report.faults import ERROR, WARN, Fault, Gap
from car_interface.tools.report.page import page, range_text
from car_interface.tools.report.plots import plots
from car_interface.tools.report.states import Episode
from tools.report.summaries import summarized
from written_recordings import Written, odometry

HOSTILE = "</td><script>alert('\"')</script>&amp;{{ 7 * 7 }}"


def changed(seen, **fields):
    """A summary with other fields."""
    other = copy.copy(seen)
    vars(other).update(fields)
    return other


class Checker(HTMLParser):
    """Collects a page's tags, and what they would load."""

    ALONE = ("meta", "path", "use", "br", "wbr", "rect")

    def __init__(self):
        super().__init__()
        self.open: list = []
        self.tags: list = []
        self.loads: list = []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.loads += [value for name, value in attributes
                       if name in ("src", "href", "xlink:href") and value and not value.startswith("#")]
        if tag not in self.ALONE:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in self.ALONE:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.ALONE:
            assert self.open.pop() == tag


@pytest.mark.more
def test_page_is_well_formed_loads_nothing_and_lets_no_text_of_the_recording_in(seen, drawn):
    text = page(seen, drawn)
    checker = Checker()
    checker.feed(text)
    assert checker.open == [] and checker.loads == []
    assert checker.tags.count("script") == 0 and checker.tags.count("svg") == 5
    assert "http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'" in text
    assert "&lt;script&gt;document.title" in text
    assert text.index('<table class="summary">') < text.index("<svg")


def test_page_says_who_drove_what_was_lost_how_the_car_followed_and_how_its_link_was(seen):
    text = " ".join(page(seen, {}).split())
    for words in (
            "The gamepad drove for 15.0 s and the planner for 20.0 s.",
            "The car was stopped once because something was lost or locked: planner silent.",
            "3 faults need somebody to look", "<tr><th>Went neutral</th><td>once: planner silent</td></tr>",
            "52.5 m", "1.50 m/s", "left 10% wider than the tables say", "0.80 m, front middle, at 10.20 s",
            "5310 frames, 2 corrupt (0.04%); 59 of 60 pings answered; the Teensy started anew once",
            "+12.5 ppm at the end, known to 0.60 ms", "av_turnrad_req silent for 0.50 s", "txPackets", "+5900"):
        assert words in text


def test_no_text_from_outside_is_anything_but_text(seen):
    drive = changed(copy.deepcopy(seen), path=f"bags/{HOSTILE.replace('/', '')}", namespace=HOSTILE,
                    notes=[HOSTILE, HOSTILE], topics={HOSTILE: Topic(HOSTILE, 1)})
    drive.steering.episodes = [episode._replace(cause=HOSTILE, reason=HOSTILE) for episode in drive.steering.episodes]
    drive.throttle.episodes = [Episode(0.0, 1.0, HOSTILE, HOSTILE, HOSTILE, 1, HOSTILE)]
    drive.limits.episodes = [Episode(0.0, 1.0, HOSTILE, HOSTILE, HOSTILE)]
    drive.limits.counts = {HOSTILE: 1}
    drive.faults.entries = [Fault(0.0, level, HOSTILE, HOSTILE, 1.0, 2) for level in (WARN, ERROR, 99)]
    drive.throttle.profile = drive.planner.source = drive.planner.others = drive.sonars.nearest_sonar = HOSTILE
    drive.sonars.frames_without_mount = {HOSTILE}
    drive.teensy.counters = {HOSTILE: (1, 2)}
    drive.coverage.gaps = lambda: [Gap(HOSTILE, HOSTILE)]
    text = page(drive, {})
    checker = Checker()
    checker.feed(text)
    assert checker.open == [] and "script" not in checker.tags and checker.loads == []
    shown = {"namespace": 1, "notes": 2, "stops": 1, "sonar": 1, "gaps": 2 * 2, "planner and profile": 3, "ESC": 2,
             "who drove": len(seen.steering.episodes), "limits": 4, "faults": 3 * 2, "mounts": 1, "counter": 1,
             "topic": 2}
    assert unescape(text).count(HOSTILE) == sum(shown.values())


def sections(text):
    """The page's sections by their ids, without what describes them."""
    return {name: re.sub(r'<h2>.*?</h2>|<p class="faint">.*?</p>', "", inside, flags=re.DOTALL).strip()
            for name, inside in re.findall(r'<section id="(.*?)">(.*?)</section>', text, re.DOTALL)}


def one_of(topic, kind, **fields):
    return Written(1.0, topic, kind, fields)


NOTHING_ON = {
    "odometry": ([odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)],
                 "who drove, faults, throttle, limits, the Teensy"),
    "odometry_of_a_car_that_stands": ([odometry(0.1 * step) for step in range(20)],
                                      "who drove, faults, steering, throttle, limits, the path, the Teensy"),
    "who_steered": ([one_of("/turn_arb/state", "car_interface/SteeringState", turn_radius=2.0)],
                    "throttle, the path, speed, the Teensy"),
    "who_drove": ([odometry(0.0), one_of("/throttle_arb/state", "car_interface/ThrottleState")],
                  "who drove, steering, the path, speed, the Teensy"),
    "planner": ([odometry(0.0), one_of("/planner_interface/state", "car_interface/PlannerState", source="drive")],
                "who drove, faults, steering, limits, the path, speed, the Teensy"),
    "board": ([one_of("/servo/output", "std_msgs/Int32MultiArray", data=[5000] * 16)],
              "who drove, faults, throttle, limits, the path, speed, the Teensy"),
    "pong": ([odometry(0.0), one_of("/teensy_clock", "car_interface/TeensyClock", round_trip=0.004)],
             "who drove, faults, steering, throttle, limits, the path, speed"),
    "log": ([odometry(0.0), one_of("/rosout", "rosgraph_msgs/Log", level=2)],
            "who drove, steering, throttle, limits, the path, speed, the Teensy"),
}


@pytest.mark.parametrize("kind", NOTHING_ON)
def test_section_that_would_be_empty_is_left_out_and_one_line_says_what_was_not_recorded(kind, tmp_path):
    messages, nothing_on = NOTHING_ON[kind]
    drive = summarized(tmp_path, messages)
    text = page(drive, plots(drive))
    found = sections(text)
    assert "contents" in found and all(found.values()), [name for name, inside in found.items() if not inside]
    (line,) = (" ".join(unescape(line).split()) for line in re.findall("Not recorded: .*?(?=</p>)", text, re.DOTALL))
    assert line.endswith(f" So this page has nothing on {nothing_on}.")
    assert all(topic not in line.split(". ")[0] for topic in drive.present)


@pytest.mark.more
def test_page_of_a_whole_drive_has_every_section_with_something_in_it(seen, drawn):
    found = sections(page(changed(seen, planner=SimpleNamespace(source="drive", others="")), drawn))
    assert list(found) == ["who", "faults", "steering", "throttle", "limits", "path", "speed", "link", "contents"]


@pytest.mark.more
def test_numbers_stand_in_columns_of_numbers_and_every_row_has_as_many_cells_as_the_head(seen, drawn):
    tables = re.findall(r"<table>(.*?)</table>", page(seen, drawn), re.DOTALL)
    assert len(tables) == 4
    for table in tables:
        head, *rows = [[attributes == ' class="number"' for attributes in re.findall(r"<t[hd]( [^>]*)?>", row)]
                       for row in re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)]
        assert rows and any(head) and all(row == head for row in rows)


@pytest.mark.parametrize("count, is_folded, more", [
    (0, False, ""), (25, False, ""), (26, True, ""), (500, True, ""), (503, True, "And 3 more.")])
def test_long_table_is_folded_and_a_very_long_one_ends_early(seen, count, is_folded, more):
    text = page(changed(seen, topics={f"/topic{number}": Topic("a/b", 1) for number in range(count)}), {})
    text = text[text.index('id="contents"'):]
    assert text.count("<td>/topic") == min(count, 500) and ("<table>" in text) == bool(count)
    assert text.count("<details>") == text.count("</details>") == is_folded
    assert (f"<summary>{count} lines</summary>" in text) == is_folded
    assert (more in text) if more else "more." not in text


def test_range_has_two_decimals_and_its_unit_and_no_negative_zero():
    assert range_text(SimpleNamespace(count=2, minimum=-0.5, maximum=12.346), "m/s²") == "-0.50 to 12.35 m/s²"
    assert range_text(SimpleNamespace(count=2, minimum=-0.001, maximum=1.0), "m/s") == "0.00 to 1.00 m/s"
