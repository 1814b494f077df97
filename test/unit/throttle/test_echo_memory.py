"""Where echoes came from, while the car drives on."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from car_interface.throttle.echo_memory import MAX_POINTS, EchoMemory
from car_interface.throttle.sonar_fan import Mount, Outline

MS, S = 1_000_000, 1_000_000_000
CONE_RAD = math.radians(30)
MOUNTS = {"front_middle": Mount(0.42, 0.0, 0.0), "front_left": Mount(0.40, 0.10, CONE_RAD),
          "rear_middle": Mount(-0.14, 0.0, math.pi)}
CAR = Outline()
PLACES = 9 + 2  # of an echo: across the cone, and beside its edges


class Car:
    """A car that drives on arcs, and looks when it is told to."""

    def __init__(self):
        self.memory, self.now_ns = EchoMemory(MOUNTS, CONE_RAD, CAR, 0.05), 0
        self.memory.move(0.0, 0.0, 0)

    def drive(self, way_m, curvature_per_m=0.0, step_m=0.01):
        for _ in range(round(abs(way_m) / step_m)):
            self.now_ns += 20 * MS
            self.memory.move(math.copysign(step_m / 0.02, way_m), curvature_per_m, self.now_ns)

    def sees(self, range_m, sonar="front_middle"):
        self.memory.look(sonar, range_m, True)

    def sees_nothing(self, sonar="front_middle", times=1):
        for _ in range(times):
            self.memory.look(sonar, 2.0, False)

    def meets(self, curvature_per_m=0.0, is_backward=False, sonar="front_middle"):
        met = self.memory.meets(curvature_per_m, is_backward).get(sonar)
        return met and met.distance_m


def test_an_echo_is_met_where_the_body_may_touch_it_first():
    car = Car()
    assert car.memory.meets(0.0, False) == {}
    car.sees(1.0)
    assert car.meets() == pytest.approx(1.0 - 0.006, abs=0.02)
    assert car.memory.meets(0.0, False)["front_middle"].is_current
    assert car.meets(is_backward=True) is None


def test_a_place_at_another_cone_s_edge_stands_for_its_neighbours_outside_of_that_cone():
    car = Car()
    car.sees(0.73)
    car.drive(0.45)
    car.sees(1.0)
    car.sees(1.0)
    before_m = car.meets()
    assert before_m == pytest.approx(0.25, abs=0.02)
    for _ in range(3):
        car.sees(1.6, "front_left")
    assert car.meets() == before_m


def test_it_stays_where_it_is_while_the_car_drives_on_for_a_second_at_most_without_any_report():
    car = Car()
    car.sees(1.0)
    before_m = car.meets()
    car.drive(0.5)
    assert car.meets() == pytest.approx(before_m - 0.5, abs=0.001)
    car.drive(-0.8)
    assert car.meets() == pytest.approx(before_m + 0.3, abs=0.001)
    car.memory.move(0.5, 0.0, car.now_ns + 60 * S)
    assert car.meets() == pytest.approx(before_m + 0.3 - 0.5, abs=0.001)


def test_the_next_echo_of_the_same_thing_stands_for_it():
    car = Car()
    for range_m in (1.0, 0.95, 0.9, 0.92):
        car.sees(range_m)
    assert car.meets() == pytest.approx(0.92 - 0.006, abs=0.02)
    assert len(car.memory._points) == PLACES


@pytest.mark.parametrize(("range_m", "is_same"), [(1.079, True), (1.082, False), (0.921, True), (0.919, False)])
def test_an_echo_is_of_the_same_thing_within_0_08_m(range_m, is_same):
    car = Car()
    car.sees(1.0)
    car.sees(range_m)
    assert (len(car.memory._points) == PLACES) == is_same


def test_an_echo_s_points_are_across_the_cone_where_the_arc_has_brought_the_car():
    car = Car()
    car.drive(0.6, 0.8)
    car.sees(1.0, "front_left")
    turn_rad = 0.6 * 0.8
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    sonar_x_m = sin / 0.8 + 0.40 * cos - 0.10 * sin
    sonar_y_m = (1.0 - cos) / 0.8 + 0.40 * sin + 0.10 * cos
    for point, part in zip(car.memory._points[2:], range(-4, 5)):
        angle_rad = turn_rad + CONE_RAD + part / 8 * CONE_RAD
        assert point.x_m == pytest.approx(sonar_x_m + math.cos(angle_rad), abs=1e-4)
        assert point.y_m == pytest.approx(sonar_y_m + math.sin(angle_rad), abs=1e-4)


def test_an_echo_is_met_at_the_same_distance_wherever_an_arc_has_brought_the_car():
    car = Car()
    car.drive(1.0, 1.0)
    car.sees(1.0)
    assert car.meets() == pytest.approx(1.0 - 0.006, abs=0.02)


def on_one_spot(*axes_deg, field_of_view_deg=30.0):
    """Sonars "0", "1"... above the rear axle of a car that is hardly larger; and where the echoes came from."""
    mounts = {str(index): Mount(0.0, 0.0, math.radians(axis_deg)) for index, axis_deg in enumerate(axes_deg)}
    memory = EchoMemory(mounts, math.radians(field_of_view_deg), Outline(front_m=0.1, rear_m=0.1, width_m=0.1), 0.0)
    memory.move(0.0, 0.0, 0)
    return memory, lambda: [(point.x_m, point.y_m) for point in memory._points]


def test_what_echoes_at_a_cone_s_edge_may_reach_5_cm_beyond_it():
    memory, places = on_one_spot(0.0)
    memory.look("0", 1.0, True)
    edge_rad = CONE_RAD / 2
    for (x_m, y_m), side in zip(places(), (-1, 1)):
        assert x_m == pytest.approx(math.cos(edge_rad) - 0.05 * math.sin(edge_rad))
        assert y_m == pytest.approx(side * (math.sin(edge_rad) + 0.05 * math.cos(edge_rad)))


@pytest.mark.parametrize(("axis_deg", "turned_deg", "is_same"), [
    (0.0, 35.9, True), (0.0, 35.95, False), (0.0, -35.9, True), (0.0, -35.95, False), (180.0, -35.9, True),
    (180.0, 35.9, True), (180.0, 35.95, False)])
def test_an_echo_is_of_the_same_thing_if_one_of_its_places_is_still_in_the_cone(axis_deg, turned_deg, is_same):
    """The last one is 5 cm beside one edge. It counts to 0.2° behind the other: 15 + atan(0.05) + 15 + asin(0.05) + 0.2
    = 35.92°.
    """
    memory, places = on_one_spot(axis_deg)
    memory.look("0", 1.0, True)
    memory.move(1e-3, math.radians(turned_deg) / 1e-3, S)
    memory.look("0", 1.0, True)
    assert (len(places()) == PLACES) == is_same


@pytest.mark.parametrize("way_m", [0.02, 0.05, 0.15])
def test_a_thin_one_that_the_car_has_just_left_beside_its_cone_is_remembered_however_often_nothing_is_seen(way_m):
    car = Car()
    car.sees(0.5)
    car.drive(way_m)
    car.sees_nothing("front_middle", 20)
    assert car.meets() == pytest.approx(0.47 - way_m, abs=0.02)


def test_other_sonars_looks_do_not_change_which_points_stand_for_their_cells():
    found = []
    for others in (0, 1, 2):
        car = Car()
        car.sees(0.3, "front_left")
        for _ in range(others):
            car.sees_nothing("rear_middle")
        car.sees_nothing("front_left")
        found.append({(point.x_m, point.y_m) for point in car.memory._points})
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize(("axis_deg", "range_m", "is_kept"), [
    (10.6, 2.0, False), (10.8, 2.0, True), (0.0, 1.09, False), (0.0, 1.07, True), (0.0, 0.5, True)],
    ids=["farther", "farther_at_its_cone_s_edge", "farther_by_9_cm", "the_same_thing", "nearer"])
def test_another_sonar_that_looks_there_twice_and_sees(axis_deg, range_m, is_kept):
    """A point at 1 m stands for its cell, 8 cm wide: of a cone of ±15° that leaves 15 − 2 − atan(0.04) = 10.71°."""
    memory, places = on_one_spot(0.0, axis_deg)
    memory.look("0", 1.0, True)
    memory.look("1", range_m, True)
    memory.look("1", range_m, True)
    assert ((1.0, 0.0) in places()) == is_kept


@pytest.mark.parametrize(("range_m", "is_kept"), [(2.5, True), (2.501, False)])
def test_what_something_nearer_hides_is_remembered_within_2_5_m(range_m, is_kept):
    memory, places = on_one_spot(0.0)
    memory.look("0", range_m, True)
    memory.look("0", 1.0, True)
    assert ((range_m, 0.0) in places()) == is_kept


def test_besides_the_newest_echo_s_points_it_remembers_the_32_nearest():
    memory, places = on_one_spot(0.0, field_of_view_deg=120.0)
    for range_m in (2.0, 0.9, 0.8, 0.7, 0.6, 0.5):
        memory.look("0", range_m, True)
    assert len(places()) == 32 + PLACES
    assert (2.0, 0.0) not in places()
    assert (0.5, 0.0) in places() and (0.6, 0.0) in places()


def test_one_that_left_its_cone_in_a_turn_is_remembered_and_in_the_way_of_the_turn_back():
    car = Car()
    car.sees(0.5, "front_left")
    car.drive(0.15, -1.0)
    car.sees_nothing("front_left", 5)
    met = car.memory.meets(1.0, False)["front_left"]
    assert not met.is_current and 0.0 < met.distance_m < 0.5
    assert "front_left" not in car.memory.meets(-1.0, False)


def test_one_at_its_cone_s_edge_is_in_the_way_also_where_it_reaches_into_the_strip_between_two_cones():
    """Its nearest place in the cone is 0.206 m to the left of the middle; the car, with its margin, ends at 0.198 m."""
    car = Car()
    car.sees(0.41, "front_left")
    assert car.meets(sonar="front_left") == pytest.approx(0.80 - 0.426, abs=0.03)


def test_one_that_slid_into_the_strip_between_two_cones_is_remembered():
    car = Car()
    car.sees(0.51, "front_left")
    car.drive(0.15, 1.0)
    car.sees_nothing("front_left", 4)
    car.sees_nothing("front_middle", 4)
    assert 0.0 < car.meets(1.0, sonar="front_left") < 0.4


def test_one_that_was_there_until_the_car_stood_and_has_gone_is_in_nobody_s_way():
    car = Car()
    for step in range(1, 10):
        car.drive(0.1)
        car.sees(1.2 - 0.1 * step)
    assert car.meets() == pytest.approx(0.3, abs=0.04)
    car.sees_nothing("front_middle", 4)
    assert car.meets() is None


def test_one_at_the_corner_of_the_bumper_is_in_the_way_until_the_car_has_passed_it():
    car = Car()
    car.sees(0.3, "front_left")
    car.drive(0.2, -0.5)
    car.sees_nothing("front_left", 5)
    assert car.meets(1.0, sonar="front_left") is not None
    car.drive(0.9)
    car.sees_nothing("front_left")
    assert car.meets(1.0, sonar="front_left") is None


@pytest.mark.parametrize(("looks", "is_forgotten"), [
    ([(2.0, False)], False), ([(2.0, False)] * 3, False), ([(2.0, False)] * 4, True), ([(1.5, True)], False),
    ([(1.5, True)] * 2, True), ([(1.5, True)] + [(2.0, False)] * 2, True)],
    ids=["one_look_without_echo", "three", "four", "one_echo_from_farther", "two_of_them", "one_and_two_without"])
def test_it_takes_more_than_one_look_to_forget_since_an_echo_may_fail_to_appear(looks, is_forgotten):
    car = Car()
    car.sees(1.0)
    for range_m, is_echo in looks:
        car.memory.look("front_middle", range_m, is_echo)
    assert (car.meets() is None or car.meets() > 1.2) == is_forgotten


def test_an_echo_from_afar_that_was_lost_once_is_kept_also_beside_a_wall():
    car = Car()
    for _ in range(12):
        car.sees(0.6, "front_left")
        car.drive(0.1)
    car.sees(2.3)
    car.memory.look("front_middle", 4.0, False)
    assert car.meets() == pytest.approx(2.294, abs=0.02)


def test_what_something_nearer_hides_is_remembered():
    car = Car()
    car.sees(1.5)
    car.sees(0.8)
    assert car.meets() == pytest.approx(0.794, abs=0.02)
    hidden = [point.x_m for point in car.memory._points if not point.is_current]
    assert hidden and min(hidden) > 1.8


def test_behind_it_is_forgotten_when_the_car_has_passed_it_backward():
    car = Car()
    car.sees(0.5, "rear_middle")
    assert car.meets(is_backward=True, sonar="rear_middle") == pytest.approx(0.468, abs=0.01)
    car.drive(-1.2)
    car.sees_nothing("rear_middle")
    assert car.memory.meets(0.0, True) == car.memory.meets(0.0, False) == {}


def test_behind_it_is_forgotten_once_it_has_gone():
    car = Car()
    car.sees(0.5, "rear_middle")
    car.sees_nothing("rear_middle", 4)
    assert car.memory.meets(0.0, True) == {}


def test_where_the_car_stands_there_is_nothing():
    car = Car()
    car.sees(0.3)
    car.drive(0.3 + 0.42 + 0.1)
    car.sees_nothing()
    assert car.memory.meets(0.0, True) == car.memory.meets(0.0, False) == {}


def test_beside_the_car_it_is_remembered_wherever_its_body_is_not():
    car = Car()
    car.sees(0.15, "front_left")
    for point in car.memory._points:
        point.x_m, point.y_m = 0.25, 0.3  # twice half of the car's width, and more
    car.sees_nothing("front_left")
    assert any(abs(point.y_m - 0.3) < 1e-9 for point in car.memory._points)


def test_what_stands_beside_the_car_is_in_the_way_of_its_body_alone_without_the_margin():
    """0.02 m beside its flank: straight on it passes, a turn towards it does not."""
    car = Car()
    car.sees(0.15, "front_left")
    for point in car.memory._points:
        point.x_m, point.y_m = 0.25, 0.168
    assert car.meets(0.0, sonar="front_left") is None
    assert car.meets(1.0, sonar="front_left") is not None


@pytest.mark.once
@given(st.lists(st.tuples(st.sampled_from(sorted(MOUNTS)), st.floats(0.0, 2.0), st.booleans(), st.floats(-0.2, 0.3),
                          st.floats(-1.0, 1.0)), max_size=60))
def test_there_are_never_more_points_than_a_decision_has_time_for(events):
    car = Car()
    for sonar, range_m, is_echo, way_m, curvature_per_m in events:
        car.drive(way_m, curvature_per_m, 0.1)
        car.memory.look(sonar, range_m, is_echo)
    assert len(car.memory._points) <= MAX_POINTS + PLACES * len(MOUNTS)
    car.memory.meets(0.3, False)
