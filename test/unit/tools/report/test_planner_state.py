"""What the planner asked for, and why it wasn't obeyed."""
from types import SimpleNamespace

import pytest

from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import WARN, FaultLog
from car_interface.tools.report.page import page
from car_interface.tools.report.states import TRACES, PlannerWatch
from car_interface.tools.report.summary import summarize
from written_recordings import Written, drive, write_ros1

OBEYED = {"source": "drive", "others": "", "cause": "planner", "reason": "drive asks for 1.00 m/s, straight on",
          "speed": 1.0, "reference_speed": 0.5}


def watched(*states):
    """A watch that was given (time, changes of a state that is obeyed) each."""
    faults = FaultLog()
    traces = {name: Trace(10.0) for name in TRACES}
    watch = PlannerWatch(traces, faults, 10.0)
    for time_s, changes in states:
        watch.on_state(time_s, SimpleNamespace(**{**OBEYED, **changes}))
    watch.finish()
    return watch, faults, traces


@pytest.mark.parametrize("cause, is_told", [
    ("planner silent", True), ("request refused", True), ("request not finite", True), ("odometry silent", True),
    ("no request", False),
])
def test_what_stopped_the_planner_is_a_fault_with_its_duration(cause, is_told):
    _, faults, _ = watched((0.0, {}), (5.0, {"cause": cause, "reason": "why"}), (5.5, {"cause": cause}), (6.0, {}))
    assert [tuple(fault)[:5] for fault in faults.entries] == (
        [(5.0, 6.0, WARN, "planner_interface", "why")] if is_told else [])


def test_speeds_are_those_of_the_times_in_which_it_was_obeyed():
    _, _, traces = watched((0.0, {}), (5.0, {"cause": "planner silent", "speed": 0.0}))
    assert (traces["planner's speed"].count, traces["planner's speed"].minimum) == (1, 1.0)
    assert traces["reference speed"].maximum == 0.5


def test_page_names_the_source_and_the_others(tmp_path):
    others = "cmd_vel: 3 messages, the last from /move_base"
    states = [Written(step / 10, "/planner_interface/state", "car_interface/PlannerState", {**OBEYED, "others": others})
              for step in range(100)]
    messages = sorted([*drive(10.0), *states], key=lambda message: message.time_s)
    text = page(summarize(str(write_ros1(tmp_path / "a.bag", messages))), {})
    assert f"The planner that was obeyed: drive; not obeyed: {others}." in text
