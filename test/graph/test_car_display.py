"""The car_display node: what it draws of the car, its trail and its steering."""
import math

import pytest
import rospkg
import rospy
from car_interface.msg import SteeringState, ThrottleState
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Range
from visualization_msgs.msg import Marker, MarkerArray

from car_interface.nodes.car_display import CarDisplay
from graph import NS_PER_S, START_NS

MARKERS = "/car_display/markers"
LINE, HEAD = 0, 1  # ids of what shows the steering
FRONT_LEFT, FRONT_RIGHT = 2, 3  # of the wheels


class Picture:

    def __init__(self, graph, **parameters):
        self.graph = graph
        graph.record(MARKERS)
        self.node = graph.add(CarDisplay, "car_display", parameters)

    def marker(self, ns, index=0):
        return next(marker for array in reversed(self.graph.messages(MARKERS)) for marker in array.markers
                    if (marker.ns, marker.id) == (ns, index))

    def steer(self, radius_m, source=SteeringState.PLANNER):
        self.graph.publish("/turn_arb/state", SteeringState(source=source, turn_radius=radius_m))
        self.graph.run(0.1)
        return self.marker("steering", LINE)

    def go_to(self, *places):
        for x_m, y_m in places:
            pose = Pose(Point(x_m, y_m, 0), Quaternion(0, 0, 0, 1))
            self.graph.publish("/odom", Odometry(pose=PoseWithCovariance(pose=pose)))

    def trail(self):
        self.graph.run(0.1)
        return [(round(point.x, 3), round(point.y, 3)) for point in self.marker("trail").points]


@pytest.fixture
def picture(graph):
    return Picture(graph)


def heading_rad(wheel):
    """Where a wheel's cylinder, which lies on its side, rolls."""
    return 2 * math.atan2(wheel.pose.orientation.y, wheel.pose.orientation.x)


def test_picture_comes_ten_times_a_second_and_at_once_to_whoever_comes_late(picture):
    graph, late = picture.graph, []
    graph.run(1.05)
    assert [record.at_ns - START_NS for record in graph.recorded[MARKERS]] == [
        index * NS_PER_S // 10 for index in range(11)]
    assert [any(marker.ns == "trail" for marker in array.markers) for array in graph.messages(MARKERS)] == [
        index in (0, 10) for index in range(11)]  # one that doesn't change is sent once a second
    picture.node.inbox.graph.subscriber(MARKERS, MarkerArray, late.append, 1)
    graph.run(0)
    assert len(late) == 1


def test_car_stands_on_the_ground_at_base_link(picture):
    picture.graph.run(0)
    body = picture.marker("body")
    assert (body.header.frame_id, body.header.stamp, body.frame_locked) == ("base_link", rospy.Time(), True)
    wheels = [picture.marker("wheels", index) for index in range(4)]
    assert [wheel.pose.position.z for wheel in wheels] == [wheel.scale.x / 2 for wheel in wheels] == [0.0475] * 4
    assert [(wheel.pose.position.x, wheel.pose.position.y) for wheel in wheels] == [
        (0.0, 0.148), (0.0, -0.148), (0.324, 0.148), (0.324, -0.148)]
    assert [heading_rad(wheel) for wheel in wheels] == pytest.approx([0.0] * 4)
    cabin = picture.marker("body", 1)
    assert cabin.pose.position.z - cabin.scale.z / 2 == pytest.approx(body.pose.position.z + body.scale.z / 2)
    assert body.scale.x == pytest.approx(0.524) and body.pose.position.x == 0.162


@pytest.mark.parametrize("radius_m, words", [(2.0, "steers: PLANNER, left 2.0 m"),
                                             (-1.0, "steers: PLANNER, right 1.0 m")])
def test_arrow_bends_on_the_commanded_arc_and_the_front_wheels_look_there(picture, radius_m, words):
    line = picture.steer(radius_m)
    nose_m = line.points[0].x
    assert line.points[0].y == 0 and line.points[-1].y * radius_m > 0
    for point in line.points:  # all of them as far from the middle of the turn as the nose
        assert math.hypot(point.x, point.y - radius_m) == pytest.approx(math.hypot(nose_m, radius_m))
    assert picture.marker("steering", HEAD).points[0] == line.points[-1]
    label = picture.marker("words")
    assert (label.action, label.text) == (Marker.ADD, words)
    # The wheelbase over each wheel's distance from the middle of the turn: 0.148 m more, or less.
    headings = [heading_rad(picture.marker("wheels", index)) for index in (FRONT_LEFT, FRONT_RIGHT)]
    assert headings == pytest.approx([math.atan(0.324 / (radius_m - y_m)) for y_m in (0.148, -0.148)])


def test_arrow_of_a_car_that_shall_go_straight_on_is_straight(picture):
    line = picture.steer(math.inf, SteeringState.TELEOP)
    assert picture.marker("words").text == "steers: TELEOP, straight on"
    assert {point.y for point in line.points} == {0.0}
    assert line.points[-1].x - line.points[0].x == pytest.approx(1.0)


def test_arrow_goes_when_the_radius_is_unknown_or_half_a_second_after_the_last_command(picture):
    assert picture.steer(3.0).action == Marker.ADD
    for unknown in (math.nan, 0.0):
        assert picture.steer(unknown).action == Marker.DELETE
        assert picture.marker("words").text == "steers: PLANNER, its turn is unknown"
    picture.steer(3.0)
    picture.graph.run(0.4)
    assert picture.marker("steering", LINE).action == Marker.ADD  # it is half a second old, and no older
    picture.graph.run(0.1)
    assert {picture.marker("steering", index).action for index in (LINE, HEAD)} == {Marker.DELETE}
    assert picture.marker("words").action == Marker.DELETE
    assert heading_rad(picture.marker("wheels", FRONT_LEFT)) == pytest.approx(0)


def test_speed_and_throttle_and_who_drives_stand_below_who_steers(picture):
    picture.steer(2.0)
    drives = ThrottleState(source=ThrottleState.TELEOP, speed=1.24, granted=0.3)
    picture.graph.publish("/throttle_arb/state", drives)
    picture.graph.run(0.1)
    assert picture.marker("words").text == "steers: PLANNER, left 2.0 m\ndrives: TELEOP, 1.2 m/s, throttle 0.30"
    drives.speed = math.nan
    picture.graph.publish("/throttle_arb/state", drives)
    picture.graph.run(0.5)
    assert picture.marker("words").text == "drives: TELEOP, throttle 0.30"  # turn_arb has fallen silent


@pytest.mark.parametrize("range_m, radius_m", [(0.7, 0.7), (math.inf, 2.0), (2.0, 2.0)])
def test_sonars_fan_moves_with_the_car_as_far_as_its_echo_or_pale_as_far_as_it_hears(picture, range_m, radius_m):
    message = Range(field_of_view=0.5, min_range=0.02, max_range=2.0, range=range_m)
    message.header.frame_id = "sonar_front_left"
    picture.graph.publish("/sonar/front_left", message)
    picture.graph.run(0.1)
    fan = picture.marker("sonars", 2)
    assert (fan.header.frame_id, fan.header.stamp, fan.frame_locked) == ("sonar_front_left", rospy.Time(), True)
    assert {round(math.hypot(point.x, point.y), 6) for point in fan.points} == {0.0, radius_m}
    assert max(abs(math.atan2(point.y, point.x)) for point in fan.points) == pytest.approx(0.25)
    assert (fan.color.a < 0.2) == (range_m != 0.7)
    picture.graph.run(1.5)
    assert picture.marker("sonars", 2).action == Marker.DELETE
    for nothing in (math.nan, -math.inf):
        message.range = nothing
        picture.graph.publish("/sonar/front_left", message)
        picture.graph.run(0.1)
        assert picture.marker("sonars", 2).action == Marker.DELETE


def test_trail_has_a_point_every_five_centimetres_and_begins_anew_after_a_jump(picture):
    picture.go_to((100.0, 0.0))
    assert picture.trail() == [(100.0, 0.0)]
    assert picture.marker("trail").action == Marker.DELETE  # a single point is no line
    assert picture.marker("trail").header.frame_id == "odom"
    picture.go_to(*((100 + step / 64, 0.0) for step in range(64)), (math.nan, 0.0))
    assert picture.trail() == [(round(100 + step / 64, 3), 0.0) for step in range(0, 64, 4)]
    assert picture.marker("trail").action == Marker.ADD
    picture.go_to((0.0, 0.0), (0.0, 0.1))
    assert picture.trail() == [(0.0, 0.0), (0.0, 0.1)]
    picture.go_to(*((0.1 * index, 0.0) for index in range(2100)))  # of which it keeps the newest two thousand
    trail = picture.trail()
    assert (len(trail), trail[0], trail[-1]) == (2000, (10.0, 0.0), (209.9, 0.0))


@pytest.mark.parametrize("namespace, prefix", [("/", ""), ("car1", "car1/")])
def test_launch_file_gives_the_frames_of_a_car_with_a_namespace_its_name(graph, namespace, prefix):
    path = f"{rospkg.RosPack().get_path('car_interface')}/launch/display.launch"
    launched = pytest.importorskip("roslaunch.config").load_config_default(
        [(path, [f"ns:={namespace}", "rviz:=false"])], None, assign_machines=False)
    assert [node.type for node in launched.nodes] == ["car_display"]
    picture = Picture(graph, frame_prefix=launched.params[f"/{prefix}car_display/frame_prefix"].value)
    graph.run(0)
    assert picture.marker("body").header.frame_id == f"{prefix}base_link"
    assert picture.marker("trail").header.frame_id == f"{prefix}odom"
