"""What of a recording is compared from drive to drive."""
import json
from types import SimpleNamespace

import pytest

from car_interface.common import causes
from car_interface.tools.report import drives
from car_interface.tools.report.drives import Row, row
from tools.report.summaries import summarized
from written_recordings import SPEED_MPS, START_NS, Written, odometry, stamp

PLANNER, NEUTRAL = 4, 2


@pytest.fixture(scope="module")
def found(seen):
    return row(seen, "day/drive.bag")


def test_row_has_what_the_drive_was_and_what_it_shows_of_the_car(found):
    assert (found.path, found.error, found.start_ns) == ("day/drive.bag", "", START_NS)
    assert found.duration_s == pytest.approx(60.0, abs=0.1)
    assert found.distance_m == pytest.approx(35 * SPEED_MPS, rel=0.01)
    assert (found.gamepad_s, found.planner_s) == (pytest.approx(15.0, abs=0.2), pytest.approx(20.0, abs=0.2))
    assert found.losses == {causes.PLANNER_STALE: 1}
    assert found.straight_per_m == pytest.approx(0.0, abs=0.001)
    assert found.left_ratio == pytest.approx(1 / 1.1, abs=0.005) and found.right_ratio is None
    assert (found.frames, found.corrupt, found.reboots, found.reopened) == (90 * 59, 2, 1, 0)
    assert found.unanswered == 0 and found.faults >= found.errors > 0
    assert found.lacks == ["/teleop_logi/state", "/throttle_arb/state"] and found.notes == []


@pytest.mark.parametrize("pings, pongs, unanswered", [(20, 20, 0), (21, 20, 0), (24, 20, 3)],
                         ids=["all_answered", "the_newest_on_its_way", "three_lost"])
def test_ping_that_is_still_on_its_way_is_not_unanswered(pings, pongs, unanswered):
    counts = {"frames": 5, "bad_frames": 1, "reconnects": 0, "reboots": 0}
    first, last = SimpleNamespace(**counts, pings=10, pongs=10), SimpleNamespace(**counts, pings=pings, pongs=pongs)
    found = drives._link_counts(SimpleNamespace(first_link=first, link=last))
    assert found["unanswered"] == unanswered and found["frames"] == 0


def test_row_survives_json(found):
    assert Row(*json.loads(json.dumps(found)))._asdict() == found._asdict()


def test_recording_of_odometry_alone_says_none_and_not_nothing(tmp_path):
    found = row(summarized(tmp_path, [odometry(0.1 * step, 0.1 * step, speed_mps=1.0, topic="/ekf")
                                      for step in range(50)]), "a.bag")
    assert found.distance_m == pytest.approx(4.9)
    for name in ("gamepad_s", "planner_s", "losses", "straight_per_m", "left_ratio", "drive_mps2", "hold_mps2",
                 "brake_mps2", "frames", "corrupt", "unanswered", "faults", "errors"):
        assert getattr(found, name) is None, name
    assert "/turn_arb/state" in found.lacks and found.notes == ["odom: /ekf (the only nav_msgs/Odometry)"]


def test_value_map_is_judged_by_what_it_got_and_not_by_what_autoware_asked_for_before_the_speed_control(tmp_path):
    asked = [message._replace(topic="/planner_interface/output/control_cmd") for message in accelerating()
             if message.topic == "/control/command/control_cmd"]
    wild = [message._replace(fields={"longitudinal": {"acceleration": 3.0}}) if "control_cmd" in message.topic else
            message for message in accelerating()]
    found = row(summarized(tmp_path, [*wild, *asked]), "a.bag")
    assert found.drive_mps2 == pytest.approx(-0.2, abs=0.02) and found.notes == []


def accelerating(duration_s=4.0, source=PLANNER):
    """A planner asks for 1 m/s², and the car does 0.8."""
    for step in range(int(duration_s * 50)):
        time_s = step / 50
        speed_mps = 0.5 + 0.8 * time_s
        yield odometry(time_s, 0.5 * time_s + 0.4 * time_s**2, speed_mps=speed_mps)
        yield Written(time_s, "/control/command/control_cmd", "car_interface/Control",
                      {"longitudinal": {"acceleration": 1.0}})
        if step % 5 == 0:
            yield Written(time_s, "/throttle_arb/state", "car_interface/ThrottleState",
                          {"stamp": stamp(time_s), "source": source, "cause": causes.DRIVING, "esc": "FORWARD"})


def test_value_map_is_off_by_what_the_car_did_more_than_requested_unless_a_human_drove(tmp_path):
    for source, expected in ((PLANNER, pytest.approx(-0.2, abs=0.02)), (3, None)):
        found = row(summarized(tmp_path, accelerating(source=source)), "a.bag")
        assert found.drive_mps2 == expected and found.hold_mps2 is found.brake_mps2 is None


def test_loss_of_the_throttle_alone_counts_once(tmp_path):
    lost = [message._replace(fields={**message.fields, "source": NEUTRAL, "cause": causes.COMMAND_STALE, "reason": "x"})
            if message.topic == "/throttle_arb/state" and message.time_s > 3 else message for message in accelerating()]
    assert row(summarized(tmp_path, lost), "a.bag").losses == {causes.COMMAND_STALE: 1}
