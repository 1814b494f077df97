"""Which recorded topic plays which role: the user's word, the usual name, a guess that is said, or none."""
import pytest

from car_interface.tools.recordings.recording import Topic
from car_interface.tools.recordings.roles import (
    ACCELERATION,
    ACKERMANN,
    COMMAND,
    IMU,
    ODOM,
    VALUE,
    find,
    other_cars,
)

ODOMETRY, DRIVE = "nav_msgs/msg/Odometry", "ackermann_msgs/msg/AckermannDriveStamped"


def recorded(*topics, count=9, **more):
    """Topics of odometry, and others as name=type with / for each double underscore."""
    found = {name: Topic(ODOMETRY, count) for name in topics}
    return {**found, **{"/" + name.replace("__", "/"): Topic(kind, count) for name, kind in more.items()}}


def found(*arguments, **options):
    """The topic for a role, and the note on it."""
    return find(*arguments, **options)[:2]


@pytest.mark.parametrize("given, expected", [
    ({}, "odom"), ({"odom": "odom"}, "odom"), ({"odom": "/missing"}, "/missing")])
def test_usual_name_goes_before_any_other_topic_of_the_type_unless_the_user_names_one(given, expected):
    assert found(recorded("/ekf/odom", "/odom"), ODOM, given=given) == (expected, "")


def test_only_topic_of_the_type_is_guessed_and_said_and_of_two_none_and_both_are_named():
    assert found(recorded("/husky_velocity_controller/odom"), ODOM) == (
        "/husky_velocity_controller/odom",
        "odom: /husky_velocity_controller/odom (the only nav_msgs/Odometry)")
    assert found(recorded(vesc__drive=DRIVE), ACKERMANN) == (
        "/vesc/drive", "ackermann: /vesc/drive (the only ackermann_msgs/AckermannDriveStamped)")
    assert find({"/a": Topic("sensor_msgs/Imu", 1)}, IMU).note == "imu: /a (the only sensor_msgs/Imu)"  # as in ROS 1
    assert found(recorded("/ekf", "/wheels"), ODOM) == (
        "odom", "odom: there are /ekf and /wheels, and no odom; say which by --map, as in --map /ekf=odom")


def test_topic_that_was_only_announced_is_no_candidate_and_a_usual_one_gives_way_to_one_with_messages():
    silent = recorded("/odom", count=0)
    assert find({**silent, **recorded("/ekf")}, ODOM).topic == "/ekf"
    assert find({**recorded("/a", count=0), **recorded("/ekf")}, ODOM).topic == "/ekf"
    assert found(silent, ODOM) == ("odom", "")


def test_what_the_speed_control_sends_to_the_value_map_goes_before_what_autoware_asks_for_unless_that_is_named():
    usual, control = "control/command/control_cmd", "car_interface/msg/Control"
    both = recorded(control__command__control_cmd=control, planner_interface__output__control_cmd=control)
    assert found(both, ACCELERATION) == ("planner_interface/output/control_cmd", "")
    assert found(both, ACCELERATION, given={"acceleration": usual}) == (usual, "")


def test_topic_that_the_user_gave_to_another_role_is_not_free():
    topics = recorded("/odom", "/car/ekf")
    assert find(topics, ODOM, given={"imu": "/odom"}).topic == "/car/ekf"
    assert find(topics, ODOM, given={"odom": "/odom"}).is_there
    assert not find(topics, ODOM, "/car", {"imu": "ekf"}).is_there
    assert find(topics, ODOM, "/car").is_there and find(topics, ODOM).fits and not find(topics, IMU).is_there


@pytest.mark.parametrize("role, kind", [(VALUE, "std_msgs/msg/Float64"), (COMMAND, "std_msgs/msg/Int32MultiArray")])
def test_types_that_may_be_anything_are_never_guessed(role, kind):
    assert found(recorded(a=kind), role) == (role.topics[0], "")


def test_namespace_has_guesses_of_its_own_and_a_topic_of_another_car_is_none():
    both = recorded("/car1/ekf", "/car2/ekf")
    assert find(both, ODOM, "/car2").topic == "/car2/ekf"
    assert find(both, ODOM).note.startswith("odom: there are /car1/ekf and /car2/ekf")
    assert found(recorded("/car10/ekf"), ODOM, "/car1") == ("odom", "")
    topics = recorded("/car1/ekf", car1__turn_arb__state="car_interface/msg/SteeringState")
    assert found(topics, ODOM) == ("odom", "") and other_cars(topics, "/") == {"/car1"}
    assert find(topics, ODOM, "/car1").topic == "/car1/ekf" and other_cars(topics, "/car1") == set()
