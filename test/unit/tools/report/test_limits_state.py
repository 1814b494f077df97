"""Which requests of a drive were cut by a limit."""
import re
from types import SimpleNamespace

from car_interface.tools.report.page import page
from car_interface.tools.report.states import LimitsWatch
from car_interface.tools.report.summary import summarize
from written_recordings import Written, drive, odometry, write_ros1

REASON = "4 m/s² sideways: at 4.0 m/s no tighter than 4.00 m, 1.00 m was asked for"


def watched(*states):
    """A watch that was given (time, node, limit, cuts) each."""
    watch = LimitsWatch()
    for time_s, node, limit, cuts in states:
        watch.on_state(time_s, SimpleNamespace(limit=limit, limit_reason=f"why {limit}", cuts=cuts), node)
    watch.finish()
    return watch


def test_a_cut_lasts_until_another_cause_or_half_a_second_without_one():
    watch = watched((0.0, "turn_arb", "", 0), (1.0, "turn_arb", "lateral acceleration", 1),
                    (1.05, "throttle_arb", "slowed for the turn", 1), (1.2, "turn_arb", "", 1),
                    (1.4, "turn_arb", "lateral acceleration", 2), (1.5, "turn_arb", "lateral jerk", 2),
                    (5.0, "turn_arb", "lateral jerk", 3))
    assert [episode[:4] for episode in watch.episodes] == [
        (1.0, 1.4, "turn_arb", "lateral acceleration"), (1.05, 1.05, "throttle_arb", "slowed for the turn"),
        (1.5, 1.5, "turn_arb", "lateral jerk"), (5.0, 5.0, "turn_arb", "lateral jerk")]
    assert watch.episodes[0].reason == "why lateral acceleration"
    assert watch.counts == {"turn_arb": 3, "throttle_arb": 0}


def test_a_restarted_node_counts_on():
    assert watched((0.0, "turn_arb", "", 5), (1.0, "turn_arb", "", 7), (2.0, "turn_arb", "", 1)).counts == {
        "turn_arb": 3}


def limited_page(tmp_path, states):
    messages = sorted([*drive(10.0), *states], key=lambda message: message.time_s)
    text = page(summarize(str(write_ros1(tmp_path / "a.bag", messages))), {})
    return re.search('<section id="limits">.*?</section>', text, re.DOTALL).group()


def test_page_shows_each_cut_and_their_count(tmp_path):
    section = limited_page(tmp_path, [Written(step / 10, "/throttle_arb/state", "car_interface/ThrottleState", {
        "source": 4, "cause": "planner", "reason": "", "esc": "FORWARD", "cuts": int(step > 50),
        **({"limit": "slowed for the turn", "limit_reason": REASON} if 50 < step < 60 else {})})
        for step in range(100)])
    assert "Requests cut: throttle_arb once." in section
    assert "<td>slowed for the turn</td>" in section and REASON in section


def test_page_of_a_drive_without_cuts_says_so_unless_its_recording_can_not_tell(tmp_path):
    assert "None was cut." in limited_page(tmp_path, [])
    text = page(summarize(str(write_ros1(tmp_path / "b.bag", [odometry(0.0)]))), {})
    assert "None was cut." not in text and "Not recorded: turn_arb/state, throttle_arb/state, " in text
