"""bag_report: what is found in a recording, how it is drawn, and the page that comes of it, in a real browser too."""
from __future__ import annotations

import copy
import io
import math
import pathlib
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib import image
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores

import written_recordings
from browser import Browser, find_browser
from car_interface.cli import bag_report
from car_interface.cli.main import main
from car_interface.recordings.recording import NoRecording
from car_interface.report import plots as report_plots
from car_interface.report.downsample import Path, Spots, Trace
from car_interface.report.page import page
from car_interface.report.plots import plots
from car_interface.report.summary import ERROR, WARN, is_loss, look_at
from written_recordings import (
    HOSTILE,
    NEUTRAL,
    NO_HUMAN,
    PLANNER,
    SPEED_MPS,
    TELEOP,
    Written,
    drive,
    odometry,
    stamp,
    write_ros1,
    write_ros2,
)

PLOTS = ["who", "steering", "path", "speed", "link"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A drive of a minute in which a lot happens, as a ROS 1 bag."""
    return str(write_ros1(tmp_path_factory.mktemp("bags") / "drive.bag", drive()))


@pytest.fixture(scope="module")
def seen(bag):
    return look_at(bag)


def faults_of(seen, where):
    return [fault for fault in seen.faults if fault.where == where]


# --- what is found ---


def test_who_drove_when_and_why_is_told_once_for_each_reason(seen):
    assert [(episode.source, round(episode.start_s, 2)) for episode in seen.episodes] == [
        (NO_HUMAN, 0.0), (TELEOP, 5.0), (PLANNER, 20.0), (NEUTRAL, 40.0)]
    assert seen.episodes[-1].reason == "av_turnrad_req silent for 0.50 s"
    assert seen.source_s[PLANNER] == pytest.approx(20.0)


def test_way_and_speed_are_those_of_odometry(seen):
    assert seen.distance_m == pytest.approx(35 * SPEED_MPS, rel=0.01)
    assert seen.moving_s == pytest.approx(35.0, abs=0.1)
    assert seen.traces["speed"].greatest == SPEED_MPS


def test_wider_turns_than_the_tables_say_are_measured_by_side(seen):
    (left, samples), (_, none) = seen.turned
    assert left == pytest.approx(1 / 1.1, abs=0.01) and samples > 500 and none == 0


def test_servo_is_found_by_what_it_holds_whatever_its_channel(seen):
    assert seen.steering_channel == 3 and sorted(seen.duties) == [2, 3]


def test_curvature_is_that_of_the_steering_backwards_too(tmp_path):
    # Backwards with the wheels to the left, radius 2 m: x and y as on the way there, the heading turns to the right.
    messages = [odometry(0.02 * step, 2 * math.sin(angle), 2 - 2 * math.cos(angle), angle, -1.0)
                for step, angle in ((step, -0.01 * step) for step in range(200))]
    seen = look_at(str(write_ros1(tmp_path / "a.bag", messages)))
    turned = seen.traces["turned curvature"]
    assert (turned.least, turned.greatest) == (pytest.approx(0.5, abs=0.01), pytest.approx(0.5, abs=0.01))


def test_sonar_hits_are_where_the_car_was(seen):
    x_m, y_m = seen.hits.places()
    assert seen.hits.count == 3 and np.abs(y_m).max() < 0.02
    # At 10.2 s it has driven for 5.2 s.
    assert x_m.min() == pytest.approx(5.2 * SPEED_MPS + 0.42 + 0.8, abs=0.1)
    assert (seen.nearest_m, seen.nearest_sonar) == (pytest.approx(0.8), "front_middle")


@pytest.mark.parametrize("where, start_s, end_s, level, what", [
    pytest.param("pca9685", 25.0, 28.0, ERROR, "nothing answers, 25 times", id="diagnostics_until_they_are_ok"),
    pytest.param("computer", 30.0, None, WARN, r"its clock was set by \+0.250 s", id="clock_that_was_set"),
    pytest.param("turn_arb", 40.0, 59.98, WARN, "av_turnrad_req silent", id="timeout"),
    pytest.param("Teensy", 50.0, 52.0, ERROR, "silent: nothing comes. look at its power", id="link"),
    pytest.param("Teensy", 52.0, None, WARN, "the Teensy started anew", id="reboot"),
])
def test_fault_is_told_with_its_moment(where, start_s, end_s, level, what, seen):
    (fault,) = [fault for fault in faults_of(seen, where) if re.match(what, fault.what)]
    assert fault.start_s == pytest.approx(start_s, abs=0.01) and fault.level == level
    assert math.isnan(fault.end_s) if end_s is None else fault.end_s == pytest.approx(end_s, abs=0.01)


def test_error_in_a_nodes_log_is_a_fault_and_its_other_lines_are_not(seen):
    assert [fault.what for fault in faults_of(seen, "pca9685")] == ["nothing answers, 25 times", HOSTILE]


def test_turn_arbs_diagnostics_are_told_once_by_its_state(seen):
    assert all("told by turn_arb/state" not in fault.what for fault in seen.faults)


def test_counters_are_told_with_their_change(seen):
    assert seen.counters == {"txPackets": (0, 5900), "rxErrorChecksum": (7, 7)}


def test_recording_of_ros_2_tells_the_same(seen, tmp_path):
    messages = [message for message in drive() if message.topic != "/rosout"]
    again = look_at(str(write_ros2(tmp_path / "drive", messages, with_definitions=False)))
    assert again.episodes == seen.episodes and again.distance_m == seen.distance_m
    assert str(again.faults) == str([fault for fault in seen.faults if fault.what != HOSTILE])


def test_car_below_a_namespace_is_found_there(seen, tmp_path):
    path = str(write_ros1(tmp_path / "car1.bag", drive(20.0, "/car1")))
    assert look_at(path, "/car1").distance_m == pytest.approx(15 * SPEED_MPS, rel=0.01)
    with pytest.raises(NoRecording, match=r"car1\.bag has no message of odom.*: try --ns /car1"):
        look_at(path)


@pytest.mark.parametrize("messages", [
    pytest.param(drive(5.0), id="only_another_cars"),
    pytest.param([*drive(5.0), Written(0.0, "/car1/sonar/front_middle", "sensor_msgs/Range", {})], id="only_a_sonar"),
])
def test_namespace_without_a_drive_is_refused_though_absolute_names_are_found(messages, tmp_path):
    path = str(write_ros1(tmp_path / "a.bag", sorted(messages, key=lambda message: message.time_s)))
    with pytest.raises(NoRecording, match=r"a\.bag has no message of odom, .* below /car1: try it without --ns$"):
        look_at(path, "/car1")


def test_topic_that_was_only_announced_is_not_there(tmp_path):
    path = announced(tmp_path, [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)])
    assert look_at(path).present == {"odom"}
    with pytest.raises(NoRecording, match="has no message of odom"):
        look_at(announced(tmp_path, []))


def announced(tmp_path, messages):
    """A recording in which turn_arb/state never said anything."""
    path, store = tmp_path / f"{len(messages)}.bag", written_recordings.typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        writer.add_connection("/turn_arb/state", "car_interface/msg/SteeringState", typestore=store)
        written_recordings._write(writer, store, store.serialize_ros1, messages)
    return str(path)


def test_message_of_another_version_is_told_with_its_type(tmp_path):
    old = ("old_interface/SteeringState", "uint8 source\nuint16 duty")
    path = write_ros1(tmp_path / "a.bag", [odometry(0.0), Written(0.1, "/turn_arb/state", old[0], {})],
                      extra_types=[old])
    path.write_bytes(path.read_bytes().replace(b"old_interface/SteeringState", b"car_interface/SteeringState"))
    with pytest.raises(NoRecording, match=r"state was recorded with another version of car_interface/SteeringState$"):
        look_at(str(path))


def test_other_topic_of_odometry_is_named_and_taken(tmp_path):
    path = str(write_ros1(tmp_path / "a.bag", [odometry(0.1 * step, 0.1 * step, speed_mps=1.0, topic="/other/state")
                                               for step in range(50)]))
    assert look_at(path, odom="other/state").distance_m == pytest.approx(4.9)
    with pytest.raises(NoRecording, match="try --odom /other/state"):
        look_at(path)


@pytest.mark.parametrize("messages, words", [
    pytest.param([Written(0.0, "/chatter", "std_msgs/String", {"data": "x"})], "it has /chatter", id="other_topics"),
    pytest.param([], "no topic at all", id="empty"),
    pytest.param([Written(0.0, "/odom", "std_msgs/String", {"data": "x"})],
                 "/odom is of type std_msgs/String; accepted: nav_msgs/Odometry", id="wrong_type"),
])
def test_recording_without_a_drive_is_refused_by_name(messages, words, tmp_path):
    path = str(write_ros1(tmp_path / "a.bag", messages))
    with pytest.raises(NoRecording, match=words) as caught:
        look_at(path)
    assert path in str(caught.value)


def test_odometry_that_begins_anew_is_no_way_and_its_silence_is_told(tmp_path):
    jump = [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(20)]
    jump += [odometry(5 + 0.1 * step, 50 + 0.1 * step, speed_mps=1.0) for step in range(20)]
    seen = look_at(str(write_ros1(tmp_path / "a.bag", jump)))
    assert seen.distance_m == pytest.approx(3.8)
    assert [fault.what for fault in seen.faults] == ["silent for 3.10 s", "began anew: 48.1 m from where it was"]


def test_clock_set_back_is_told_and_leaves_accelerations_sane(tmp_path):
    messages = [odometry(10 + 0.02 * step, speed_mps=1.0) for step in range(200)]
    messages += [odometry(5 + 0.02 * step, speed_mps=1.0) for step in range(200)]
    seen = look_at(str(write_ros1(tmp_path / "a.bag", messages)))
    assert seen.traces["acceleration"].greatest == seen.traces["acceleration"].least == 0.0
    assert any("went back once" in fault.what for fault in seen.faults)


def test_small_step_back_of_the_recording_time_is_no_fault(tmp_path):
    times = [0.02 * step - (0.4 if step >= 100 else 0.0) for step in range(200)]
    seen = look_at(str(write_ros1(tmp_path / "a.bag", [odometry(time_s, speed_mps=1.0) for time_s in times])))
    assert not [fault for fault in seen.faults if "went back" in fault.what]


def test_numbers_that_are_none_are_left_out(tmp_path):
    messages = [odometry(0.02 * step, speed_mps=math.nan if step == 5 else 1.0) for step in range(50)]
    messages.append(Written(0.5, "/av_turnrad_req", "std_msgs/Float32", {"data": math.nan}))
    seen = look_at(str(write_ros1(tmp_path / "a.bag", messages)))
    assert seen.traces["speed"].count == 49 and seen.traces["asked curvature"].count == 0


def test_flood_of_faults_is_kept_to_a_bound_and_counted(tmp_path):
    messages = [odometry(0.0)]
    for step in range(6000):
        messages.append(Written(0.01 * step, "/diagnostics", "diagnostic_msgs/DiagnosticArray", {
            "header": {"stamp": stamp(0.01 * step)},
            "status": [{"name": "a: b", "level": step % 2, "message": "again"}]}))
    seen = look_at(str(write_ros1(tmp_path / "a.bag", messages)))
    assert len(seen.faults) == 2000 and seen.pending == 1000
    assert "1000 more are not kept" in page(seen, {})


@pytest.mark.parametrize("reason, lost", [
    ("human_in_loop silent for 0.52 s", True), ("tele_steer_req is nan, no number to act on", True),
    ("human_in_loop was silent; let go once: publish false, then true", True), ("human_in_loop is false", False),
    ("human_in_loop was silent: let go of the deadman, then hold it again", True),
    ("neither tele_steer_req nor av_turnrad_req asks for anything", False)])
def test_loss_is_told_from_nobody_asking(reason, lost):
    assert is_loss(reason) == lost


# --- what is kept is bounded ---


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(-5, 5)), min_size=1, max_size=300), st.integers(1, 20))
def test_trace_keeps_every_extreme_and_invents_nothing(samples, stretches):
    trace = Trace(0.0, 10.0, stretches)
    for time_s, value in samples:
        trace.add(time_s, value)
    times, values = trace.curve(gap_s=100)
    kept = {(time_s, value) for time_s, value in zip(times, values)}
    assert kept <= set(samples) and len(times) <= 2 * stretches and (np.diff(times) >= 0).all()
    assert (values.min(), values.max()) == (min(value for _, value in samples), max(value for _, value in samples))
    assert (trace.least, trace.greatest, trace.count) == (values.min(), values.max(), len(samples))


def test_trace_breaks_where_nothing_came():
    trace = Trace(0.0, 100.0)
    for time_s in (0, 0.5, 1, 50, 50.5):
        trace.add(time_s, 1.0)
    _, values = trace.curve()
    (gap,) = np.flatnonzero(np.isnan(values))
    assert 0 < gap < len(values) - 1


def test_path_of_any_length_keeps_few_points_and_its_shape():
    path = Path(step_m=0.01, most=500)
    for step in range(100_000):
        path.add(math.cos(step / 1000) * (1 + step / 1e5), math.sin(step / 1000), 3)
    assert 200 < len(path.x_m) <= 500 and max(path.x_m) > 1.9


def test_path_that_is_interrupted_stays_so_however_often_it_is_thinned():
    path = Path(step_m=0.01, most=100)
    for step in range(1000):
        path.add(step / 50, 0.0, 3)
        if step == 33:
            path.interrupt()
    assert [math.isnan(x_m) for x_m in path.x_m].count(True) == 1 and len(path.x_m) <= 100


def test_path_of_nothing_but_interruptions_is_bounded_too():
    path = Path(step_m=0.01, most=100)
    for step in range(1000):
        path.add(step, 0.0, 3)
        path.interrupt()
    assert len(path.x_m) <= 101


def test_path_keeps_each_change_of_driver():
    path = Path()
    for step, kind in enumerate((1, 1, 3, 3, 4)):
        path.add(step / 1e4, 0.0, kind)
    assert list(path.kinds) == [1, 3, 4]


def test_spots_without_end_keep_few_cells_within_half_of_their_width():
    spots = Spots(cell_m=0.01, most=300)
    random = np.random.default_rng(1)
    for x_m, y_m in random.uniform(-3, 3, size=(5000, 2)):
        spots.add(x_m, y_m)
    x_m, y_m = spots.places()
    assert len(x_m) <= 300 and spots.count == 5000 and np.abs(x_m).max() <= 3 + spots.cell_m


# --- the plots ---


def test_each_plot_is_one_svg_with_ids_of_its_own(seen):
    made = plots(seen)
    assert list(made) == PLOTS
    ids = [name for plot in made.values() for name in re.findall(r'\bid="([^"]+)"', plot.svg)]
    assert len(ids) == len(set(ids))
    for plot in made.values():
        assert plot.svg.startswith('<svg role="img" aria-label="') and plot.svg.count("</svg>") == 1
        used = set(re.findall(r'(?:href="#|url\(#)([\w.-]+)', plot.svg))
        assert used <= set(re.findall(r'\bid="([^"]+)"', plot.svg))


@pytest.mark.once
@pytest.mark.parametrize("changed", [
    ("asked curvature", "speed", "frames"), ("sent curvature", "acceleration", "bad frames"),
    ("turned curvature", "asked acceleration", "round trip"), ("gamepad", "value", "skew")], ids=", ".join)
def test_each_trace_shows_in_its_plot(changed, seen):
    other = copy.copy(seen)
    other.traces = dict(seen.traces)
    for name in changed:
        other.traces[name] = Trace(0.0, seen.duration_s)
        for step in range(200):
            other.traces[name].add(seen.duration_s * step / 200, 0.3 * math.sin(step / 7))
    before, after = plots(seen), plots(other)
    assert [name for name in PLOTS if before[name] != after[name]] == ["steering", "speed", "link"]


def test_plot_of_a_recording_that_lacks_its_topics_is_left_out(tmp_path):
    path = str(write_ros1(tmp_path / "a.bag", [odometry(0.1 * step, 0.1 * step, speed_mps=1.0) for step in range(50)]))
    seen = look_at(path)
    assert list(plots(seen)) == ["steering", "path", "speed"]
    text = page(seen, plots(seen))
    assert "Not recorded: turn_arb/state" in text and "Not recorded: teensy_sensor_hub/link, teensy_clock" in text


def test_steering_shows_what_was_turned_where_that_is_tighter_than_what_was_sent(tmp_path):
    messages = [odometry(0.02 * step, math.sin(0.02 * step), 1 - math.cos(0.02 * step), 0.02 * step, 1.0)
                for step in range(500)]
    figure = report_plots._steering(look_at(str(write_ros1(tmp_path / "a.bag", messages))))
    low, high = figure.axes[0].get_ylim()
    assert low < -1.0 and high > 1.0  # 1/m


def test_servos_channel_is_not_drawn_as_the_escs_though_nobody_says_which_it_is(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(report_plots, "_curve", lambda axes, trace, colour, label, *_, **__: drawn.append(label))
    messages = [Written(0.1 * step, "/servo/output", "std_msgs/Int32MultiArray",
                        {"data": [5000 + 16 * step, 4912 + 16 * step] + [0] * 14}) for step in range(20)]
    seen = look_at(str(write_ros1(tmp_path / "a.bag", messages)))
    with monkeypatch.context() as patch:
        patch.setattr(report_plots, "title", lambda axes, text: drawn.append(text))
        report_plots._speed(seen)
    assert drawn == ["The ESC's duty", "duty on channel 1"]


@pytest.mark.once
def test_plots_of_a_long_drive_are_no_larger_than_those_of_a_short_one(tmp_path):
    random = np.random.default_rng(2)
    sizes = []
    for count in (10_000, 40_000):
        messages = [odometry(600 * step / count, speed_mps=random.normal()) for step in range(count)]
        seen = look_at(str(write_ros1(tmp_path / f"{count}.bag", messages)))
        sizes.append(len(plots(seen)["speed"].svg))
    assert sizes[1] < 1.3 * sizes[0]


@pytest.mark.parametrize("message", [odometry(0.0), Written(0.0, "/turn_arb/state", "car_interface/SteeringState", {}),
                                     Written(0.0, "/servo/output", "std_msgs/Int32MultiArray", {"data": [0] * 16})])
def test_single_message_makes_a_page_too(message, tmp_path):
    seen = look_at(str(write_ros1(tmp_path / "a.bag", [message])))
    assert "</html>" in page(seen, plots(seen))


# --- the page ---


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


def test_page_is_well_formed_loads_nothing_and_lets_no_text_of_the_recording_in(seen):
    text = page(seen, plots(seen))
    checker = Checker()
    checker.feed(text)
    assert checker.open == [] and checker.loads == []
    assert checker.tags.count("script") == 0 and checker.tags.count("svg") == len(PLOTS)
    assert "http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'" in text
    assert "&lt;script&gt;document.title" in text


@pytest.mark.parametrize("words", [
    "The gamepad drove for 15.0 s and the planner for 20.0 s.",
    "The car was stopped once because something was lost or locked.", "3 faults need somebody to look",
    "<tr><th>Went neutral</th><td>once: av_turnrad_req silent</td></tr>", "52.5 m", "1.50 m/s",
    "left 10% wider than the tables say", "0.80 m, front middle, at 10.20 s",
    "5310 frames, 2 corrupt (0.04%); 59 of 60 pings answered; the Teensy started anew once",
    "+12.5 ppm at the end, known to 0.60 ms",
    "av_turnrad_req silent for 0.50 s", "txPackets", "+5900"])
def test_page_says(words, seen):
    assert words in page(seen, {})


def test_summary_table_comes_before_everything_else(seen):
    text = page(seen, plots(seen))
    assert text.index('<table class="summary">') < text.index("<svg")


# --- the command ---


def test_command_writes_the_page_and_says_where(bag, tmp_path, capsys):
    out = tmp_path / "out.html"
    assert main("bag_report", [bag, "-o", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}\n" and out.read_text(encoding="utf-8").endswith("</html>\n")
    assert out.stat().st_mode & 0o077 == 0o044


def test_command_without_output_puts_the_page_beside_the_recording(bag, capsys):
    assert main("bag_report", [bag]) == 0
    assert capsys.readouterr().out == bag.replace(".bag", ".html") + "\n"


@pytest.mark.once
def test_several_recordings_get_a_page_each_and_a_bad_one_stops_no_other(bag, tmp_path, capsys):
    bad = tmp_path / "bad.bag"
    bad.write_bytes(b"no bag")
    assert main("bag_report", [str(bad), bag, "-o", str(tmp_path), "--jobs", "2"]) == 1
    shown = capsys.readouterr()
    assert shown.out == f"{tmp_path / 'drive.html'}\n"
    assert shown.err == f"bag_report: {bad} can't be read as a recording: it is no bag\n"


@pytest.mark.parametrize("arguments, words", [
    pytest.param(["a.bag", "b.bag", "-o", "nowhere"], "is no folder, and 2 recordings need one", id="no_folder"),
    pytest.param(["a/x.bag", "b/x.bag", "-o", "."], "would both get the page x.html", id="same_name"),
    pytest.param(["a.bag"], "a.bag can't be read as a recording: there is no such file", id="missing"),
])
def test_what_can_not_be_done_is_told_in_one_line(arguments, words, capsys):
    assert main("bag_report", arguments) == 1
    shown = capsys.readouterr()
    assert words in shown.err and shown.err.count("\n") == 1


def test_page_that_can_not_be_written_is_told_and_leaves_nothing(bag, tmp_path, capsys):
    assert main("bag_report", [bag, "-o", str(tmp_path / "none" / "a.html")]) == 1
    assert "there is no folder" in capsys.readouterr().err and list(tmp_path.iterdir()) == []


def test_page_replaces_an_old_one_but_never_a_recording(bag, tmp_path, capsys):
    old, recording = tmp_path / "old.html", pathlib.Path(bag).read_bytes()
    old.write_text("old")
    assert main("bag_report", [bag, "-o", str(old)]) == 0
    assert old.read_text().endswith("</html>\n") and [path.name for path in tmp_path.iterdir()] == ["old.html"]
    capsys.readouterr()
    assert main("bag_report", [bag, "-o", bag]) == 1
    assert capsys.readouterr().err.startswith(f"bag_report: {bag} is one of the recordings")
    assert pathlib.Path(bag).read_bytes() == recording


def test_recording_that_breaks_the_report_stops_no_other(bag, tmp_path, capsys, monkeypatch):
    other = str(tmp_path / "other.bag")
    shutil.copy(bag, other)
    monkeypatch.setattr(bag_report, "plots", lambda seen: {bag: {}}[seen.path])
    assert main("bag_report", [other, bag, "-o", str(tmp_path), "--jobs", "1"]) == 1
    shown = capsys.readouterr()
    assert shown.out == f"{tmp_path / 'drive.html'}\n"
    assert shown.err == f"bag_report: {other}: no page can be made of it (KeyError: {other!r})\n"


def test_page_of_a_car_below_a_namespace_has_that_in_its_name(tmp_path, capsys):
    path = write_ros1(tmp_path / "drive.bag", drive(10.0, "/car1"))
    for option in ("--ns", "--namespace"):
        assert main("bag_report", [str(path), option, "/car1/"]) == 0
        assert capsys.readouterr().out == f"{tmp_path / 'drive.car1.html'}\n"


# --- in a browser ---


@pytest.mark.browser
@pytest.mark.skipif(find_browser() is None, reason="no Chromium on this computer")
def test_page_in_chromium_shows_every_plot_and_complains_of_nothing(bag, tmp_path):
    out = tmp_path / "out.html"
    assert main("bag_report", [bag, "-o", str(out)]) == 0
    with Browser(find_browser()) as browser:
        browser.open(out)
        places = browser.evaluate(
            "[...document.querySelectorAll('svg[data-plot]')].map(svg => { const box = svg.getBoundingClientRect();"
            " return [svg.dataset.plot, box.left, box.top + scrollY, box.width, box.height]; })")
        title = browser.evaluate("document.title")
        wide = browser.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        picture = image.imread(io.BytesIO(browser.picture()))
    assert browser.complaints == [] and browser.requests == [out.resolve().as_uri()]
    assert title == "Drive: drive.bag" and wide == 0
    assert [place[0] for place in places] == PLOTS
    for name, left, top, width, height in places:
        part = picture[round(top):round(top + height), round(left):round(left + width), :3]
        assert abs(part.shape[0] - height) < 2 and abs(part.shape[1] - width) < 2, f"{name} is cut off"
        assert width > 800 and height > 80, name
        inked = (part.min(axis=2) < 0.8).mean(axis=0)  # by column
        assert (inked > 0).mean() > 0.35, f"{name} is all but empty"
        coloured = (part.max(axis=2) - part.min(axis=2) > 0.25).mean()
        assert coloured > 0.0005, f"{name} has no curve in it"
