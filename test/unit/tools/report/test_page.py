"""The page about a drive."""
from __future__ import annotations

from html.parser import HTMLParser

import pytest

from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from written_recordings import Written, odometry, write_ros1

PLOTS = ["who", "steering", "path", "speed", "link"]


class Checker(HTMLParser):
    """Collects a page's tags, and what they would load."""

    ALONE = ("meta", "path", "use", "br", "rect")

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


def test_page_is_well_formed_loads_nothing_and_lets_no_text_of_the_recording_in(seen, drawn):
    text = page(seen, drawn)
    checker = Checker()
    checker.feed(text)
    assert checker.open == [] and checker.loads == []
    assert checker.tags.count("script") == 0 and checker.tags.count("svg") == len(PLOTS)
    assert "http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'" in text
    assert "&lt;script&gt;document.title" in text
    assert text.index('<table class="summary">') < text.index("<svg")


def test_page_says_who_drove_what_was_lost_how_the_car_followed_and_how_its_link_was(seen):
    text = page(seen, {})
    for words in (
            "The gamepad drove for 15.0 s and the planner for 20.0 s.",
            "The car was stopped once because something was lost or locked: planner silent.",
            "3 faults need somebody to look", "<tr><th>Went neutral</th><td>once: planner silent</td></tr>",
            "52.5 m", "1.50 m/s", "left 10% wider than the tables say", "0.80 m, front middle, at 10.20 s",
            "5310 frames, 2 corrupt (0.04%); 59 of 60 pings answered; the Teensy started anew once",
            "+12.5 ppm at the end, known to 0.60 ms", "av_turnrad_req silent for 0.50 s", "txPackets", "+5900"):
        assert words in text


@pytest.mark.parametrize("message", [odometry(0.0), Written(0.0, "/turn_arb/state", "car_interface/SteeringState", {}),
                                     Written(0.0, "/servo/output", "std_msgs/Int32MultiArray", {"data": [0] * 16})])
def test_single_message_makes_a_page_too(message, tmp_path):
    seen = summarize(str(write_ros1(tmp_path / "a.bag", [message])))
    assert "</html>" in page(seen, plots(seen))
