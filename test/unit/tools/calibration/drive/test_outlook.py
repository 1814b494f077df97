"""Where the car goes from here, and how fast it may."""
import math
from types import SimpleNamespace

import numpy as np
import pytest

from car_interface.throttle.obstacle_stop import ObstacleConfig, ObstacleStop, Outline
from car_interface.tools.calibration.drive.area import Area, Pose, Turn, moved
from car_interface.tools.calibration.drive.config import CalibrationDriveConfig
from car_interface.tools.calibration.drive.knowledge import Knowledge
from car_interface.tools.calibration.drive.outlook import SPARE_M, Outlook
from car_interface.tools.calibration.drive.positions import Candidate, Hold, Measured
from car_interface.tools.calibration.drive.survey import Survey
from car_interface.tools.calibration.steering.drive import CurveFitConfig, Delay
from tools.calibration.drive.light_car import S, base

LEFT, CENTER, RIGHT = 3900, 5184, 6400
ACROSS = Pose(-1.5, 1.0, 0.0)


def outlook(pose, speed_mps=1.0, braking_mps2=1.0, least_mps2=math.inf):
    """Of a car that rolls straight on, is at a pose by now, and was seen to stop as the last argument says."""
    survey = Survey(base(), CalibrationDriveConfig(braking_mps2=braking_mps2))
    for tick in range(20):
        survey.motion.update(moved(pose, -0.02 * speed_mps * (19 - tick), 0.0), speed_mps, tick * S // 50)
    at = np.array([0.0])  # of no duty that is driven
    survey.positions.update_knowledge(Knowledge("", at, at, at, at, given=CurveFitConfig(Delay(0.05, 0.15))), 0)
    stops = SimpleNamespace(least_mps2=least_mps2)
    one = Outlook(survey, Area((0.0, 0.0), 2.88), ObstacleStop(ObstacleConfig()), stops)
    one.servo_duty = CENTER
    return one


def settled(duty):
    return Hold(Candidate(duty, 1.0, 0), duty, (LEFT, RIGHT), Delay(0.05, 0.1), 0), 10 * S


def allowed_mps(one):
    hold, now_ns = settled(CENTER)
    return one.allowed_mps(hold, False, now_ns)


@pytest.mark.parametrize("coasts_mps2", [0.1, 0.2])
@pytest.mark.parametrize("x_m", [-1.5, -1.0, 0.0])
def test_when_the_button_is_let_go_it_coasts_to_a_stop_inside(x_m, coasts_mps2):
    speed_mps, text = allowed_mps(outlook(Pose(x_m, 0.0, 0.0), least_mps2=coasts_mps2))
    assert text == "" and speed_mps > 0.4
    assert x_m + 0.43 + 0.15 * speed_mps + speed_mps ** 2 / (2 * coasts_mps2) < 3.0


def test_a_brake_that_is_known_does_not_brake_when_the_button_is_let_go():
    weak, strong = (outlook(Pose(0.0, 0.0, 0.0), braking_mps2=braking_mps2) for braking_mps2 in (0.2, 3.0))
    assert allowed_mps(strong)[0] == allowed_mps(weak)[0] < 1.0 < strong.cruise_mps(0.0)


def test_a_car_that_was_seen_to_stop_later_is_slower_and_none_is_faster_by_what_was_seen():
    speeds = [allowed_mps(outlook(ACROSS, least_mps2=least_mps2))[0] for least_mps2 in (0.1, 0.2, 0.8, math.inf)]
    assert speeds[0] + 0.1 < speeds[1] == speeds[2] == speeds[3]


def test_tight_turns_are_slower():
    one = outlook(ACROSS)
    assert one.cruise_mps(1.0) < one.cruise_mps(0.5) < one.cruise_mps(0.0)


def test_a_car_with_no_room_to_turn_is_to_be_moved_to_the_middle_or_placed_for_its_turn():
    speed_mps, text = allowed_mps(outlook(Pose(2.3, 0.0, 0.0), 0.0))
    assert speed_mps == 0.0 and "no room to turn: move it towards the middle by hand or by" in text
    wide = outlook(Pose(2.0, 0.0, 0.0), 0.0)
    for duty, curvature_per_m in ((LEFT, 0.6), (RIGHT, -0.55)):
        wide._survey.positions.add(Measured(duty, 1, curvature_per_m))
    text = allowed_mps(wide)[1]
    assert "no room to turn: place it so that the middle is about 1.7 m to its left, by hand or by" in text


def test_it_turns_before_the_edge_and_a_car_that_coasts_far_sooner():
    hold, now_ns = settled(CENTER)
    assert not outlook(Pose(-1.0, 0.0, 0.0)).is_outside_soon(hold, now_ns)
    assert outlook(Pose(1.8, 0.0, 0.0)).is_outside_soon(hold, now_ns)
    # Along the edge the turn alone would do later.
    assert not outlook(Pose(1.0, 1.85, -0.2), 0.4).is_outside_soon(hold, now_ns)
    assert outlook(Pose(1.0, 1.85, -0.2), 0.4, least_mps2=0.1).is_outside_soon(hold, now_ns)


def test_room_ends_where_a_car_that_coasts_far_or_is_too_fast_could_no_longer_stop_inside():
    along = Pose(0.6, 1.85, -0.2)  # where the turn alone would do for longer
    rooms = [max(outlook(along, 0.4, least_mps2=least).rooms_m(CENTER, 0.0, 0.4, 10.0)) for least in (0.1, math.inf)]
    assert rooms[0] < rooms[1]
    rooms = [max(outlook(ACROSS, speed_mps).rooms_m(CENTER, 0.0, 1.2, 10.0)) for speed_mps in (0.5, 0.9, 1.5)]
    # From 0.9 m/s it coasts for 2.2 m with 0.2 m/s², from 1.5 m/s for 5.9 m; there are 3.9.
    assert rooms[0] == pytest.approx(rooms[1], abs=0.3) and 1.2 < rooms[0] < 3.9 and rooms[2] < 0.5
    # Where the turn begins a faster one is as slow as is allowed there, too.
    slow, fast = (outlook(ACROSS).rooms_m(CENTER, 0.0, speed_mps, 10.0) for speed_mps in (1.0, 3.0))
    assert slow == pytest.approx(fast)


def test_room_counts_with_the_speed_that_it_has_while_it_steers():
    slow, fast = (outlook(ACROSS, speed_mps) for speed_mps in (0.5, 2.0))
    assert slow.now_mps == pytest.approx(0.5) and fast.now_mps == pytest.approx(2.0)
    assert outlook(ACROSS, 0.0).now_mps == pytest.approx(0.33)


def test_the_path_is_the_positions_while_the_servo_is_on_its_way():
    one = outlook(ACROSS)
    hold = Hold(Candidate(LEFT, 1.0, 0), CENTER, (LEFT, RIGHT), Delay(0.05, 0.1), 0)
    assert one.path_per_m(None, 0) == pytest.approx(0.0, abs=1e-6)
    assert one.path_per_m(hold, 0) > 0.3
    assert one.path_per_m(hold, 10 * S) == pytest.approx(0.0, abs=1e-6), "settled: as it is measured"


@pytest.mark.parametrize("half_duty, lags", [(4600, 1.0), (3916, 3.9)], ids=("smooth", "steep_at_its_end"))
def test_a_linkage_that_turns_the_wheels_within_the_last_counts_turns_later(half_duty, lags):
    one = outlook(ACROSS)
    from_right, from_left = (one.turns(duty)[0].reaction_s for duty in (RIGHT, LEFT))
    assert from_right > from_left, "a servo that is at the other end turns later"
    for duty, curvature_per_m in ((LEFT, 1.0), (half_duty, 0.6), (CENTER, 0.0)):
        one._survey.positions.add(Measured(duty, 1, curvature_per_m))
    reaction_s = one.turns(CENTER)[0].reaction_s
    # A servo's lag of 0.15 s: after so many of them the wheels turn half as tightly as at the end.
    assert reaction_s == pytest.approx(0.17 + 0.15 * lags, abs=0.05)


# --- room, of a car without delay ---

OUTLINE = Outline(front_m=0.4, rear_m=0.1, width_m=0.3)
START, BEYOND_MPS = Pose(0.0, 0.0, 0.0), 99.0
TURNS = (Turn(1.0, 0.3), Turn(-1.0, 0.3))


class Way(Outlook):
    """Its turns are those, begun with 1 m/s; it stops on them within ``stop_m``, and let go within ``let_go_m``, less
    by ``slower`` for each metre that it has gone.
    """

    slow_mps = 0.0
    now_mps = property(lambda self: math.sqrt(self.let_go_m))

    def __init__(self, pose, stop_m=0.0, let_go_m=0.0, slower=0.0, stop_radius_m=None):
        motion = SimpleNamespace(pose=pose, curvature_per_m=lambda: 0.0)
        super().__init__(SimpleNamespace(
            base=base(), config=CalibrationDriveConfig(), motion=motion, positions=None, ends=(LEFT, RIGHT),
            servo_delay=(0.0, 0.0)), Area((0.0, 0.0), 3.0, OUTLINE, stop_radius_m), None, None)
        self.stop_m, self.let_go_m, self.slower = stop_m, let_go_m, slower

    def turns(self, from_duty):
        return TURNS

    def _coasts_mps2(self):
        return self.slower / 2

    def _stop_m(self, speed_mps=None):
        return self.stop_m if speed_mps is None else speed_mps ** 2 - SPARE_M

    def _slowed_mps(self, ahead_m):
        return 1.0


def rooms_m(pose, curvature_per_m=0.0, max_m=10.0, way=Way, **stops):
    return way(pose, **stops).rooms_m(CENTER, curvature_per_m, BEYOND_MPS, max_m)


def extents_m(pose, curvature_per_m=0.0):
    ways = Area((0.0, 0.0), 3.0, OUTLINE).ways_out(pose, curvature_per_m, TURNS, 1.0, 0.0)
    return [way.extent_m for way in ways]


def test_room_ends_where_the_last_turn_would_leave_the_area():
    free_m = max(rooms_m(START))
    assert 0.8 < free_m < 1.8
    beyond = moved(START, free_m + 0.2, 0.0)
    assert min(extents_m(beyond)) > 3.0
    assert rooms_m(START, max_m=0.4) == [0.4, 0.4]
    assert rooms_m(START, 1.0, 50.0) == [50.0, 50.0], "a circle that stays inside"
    pose = Pose(-1.0, 1.0, 0.0)
    rooms = [max(rooms_m(pose, stop_m=stop_m)) for stop_m in (0.0, 0.3, 0.9)]
    assert rooms[0] > rooms[1] > rooms[2] > 0.0, "less for a car that takes longer to stop"
    assert max(rooms_m(pose, stop_m=0.3, stop_radius_m=3.5)) == rooms[0]


def test_the_turn_towards_the_center_can_begin_later_than_the_other_one():
    pose = Pose(-1.5, 0.5, 0.0)  # the center is to the right
    left_m, right_m = rooms_m(pose)
    assert left_m < right_m - 0.3
    for turn, room_m in zip((0, 1), (left_m, right_m)):
        extents = [extents_m(moved(pose, at_m, 0.0))[turn] for at_m in (room_m, room_m + 0.2)]
        assert extents[0] <= 3.0 < extents[1]


def test_a_turn_that_fits_only_later_on_the_way_counts_from_there():
    pose, curvature = Pose(-0.8, 0.7, 0.2), -0.4
    stays = [extents_m(moved(pose, at_m, curvature), curvature)[0] <= 3.0 for at_m in (0.0, 0.6, 1.4)]
    assert stays == [False, True, False]
    assert rooms_m(pose, curvature)[0] == pytest.approx(1.0)


def test_a_turn_is_as_late_as_it_is_from_where_it_begins():
    class Fast(Way):

        def _slowed_mps(self, ahead_m):
            return 4.0

    class Slowed(Way):

        def _slowed_mps(self, ahead_m):
            return 1.0 if ahead_m < 2.6 else 4.0  # behind the middle
    late_m, slowed_m, early_m = (max(rooms_m(ACROSS, way=way)) for way in (Way, Slowed, Fast))
    assert late_m == slowed_m > early_m + 0.5


def test_room_ends_earlier_where_it_must_be_able_to_go_straight_on():
    pose = Pose(-2.0, 1.0, 0.3)
    far_m, near_m = max(rooms_m(pose)), max(rooms_m(pose, let_go_m=2.0))
    assert 0.0 < near_m < far_m
    assert Area((0.0, 0.0), 3.0, OUTLINE).ahead_m(moved(pose, near_m, 0.0), 3.0) == pytest.approx(2.0, abs=0.2)
    room_m, slower_m = (max(rooms_m(ACROSS, let_go_m=3.0, slower=slower)) for slower in (0.0, 1.0))
    assert room_m == pytest.approx(0.8) and slower_m > room_m + 0.3, "by the distance that it has gone"
