"""Who may publish on a topic that a node obeys: the right type, and nobody else."""
import pytest

from car_interface.common import causes
from car_interface.common.publishers import (
    CommandTopic,
    FaultLog,
    Publisher,
    find_faults,
    find_unheard_planner,
    second_publisher,
)
from car_interface.common.units import NS_PER_S

FLOAT, DOUBLE = "std_msgs/Float32", "std_msgs/Float64"
PLANNER = Publisher("/planner", "car", FLOAT)
LAPTOPS = Publisher("/planner", "laptop", DOUBLE)
BY_HAND = Publisher("/rostopic_12_34", "laptop", FLOAT)
TELEOP = Publisher("/teleop_logi", "car", FLOAT)


def topic(*publishers, is_shared=False):
    return CommandTopic("/av_turnrad_req", FLOAT, publishers, is_shared)


@pytest.mark.parametrize("publishers, is_shared, found", [
    ([], False, []),
    ([PLANNER], False, []),
    ([PLANNER, LAPTOPS], False, [causes.WRONG_TYPE]),
    ([PLANNER, Publisher("/other", "laptop", "")], False, [causes.UNKNOWN_HOST]),
    ([PLANNER, TELEOP], False, [causes.SECOND_PUBLISHER]),
    ([TELEOP, PLANNER, LAPTOPS], True, [causes.WRONG_TYPE]),
])
def test_second_publisher_is_one_whose_messages_arrive_where_only_one_may_be(publishers, is_shared, found):
    assert [fault.cause for fault in find_faults(topic(*publishers, is_shared=is_shared))] == found


def test_topic_of_two_types_takes_either_and_names_both_and_one_that_is_only_counted_takes_any():
    both = CommandTopic("/cmd_vel", f"{FLOAT} or {DOUBLE}", (PLANNER,))
    assert find_faults(both) == [] == find_faults(both._replace(publishers=(LAPTOPS,)))
    fault, = find_faults(both._replace(publishers=(Publisher("/planner", "car", "std_msgs/Bool"),)))
    assert fault.cause == causes.WRONG_TYPE and "which takes std_msgs/Float32 or std_msgs/Float64: " in fault.reason
    fault, = find_faults(both._replace(publishers=(PLANNER, LAPTOPS)))
    assert fault.cause == causes.SECOND_PUBLISHER
    assert find_faults(CommandTopic("/cmd_vel", "*", (PLANNER, LAPTOPS, TELEOP), is_shared=True)) == []


def test_publisher_on_a_computer_whose_name_is_unknown_is_reported_with_the_remedy():
    fault, = find_faults(topic(Publisher("/planner", "laptop", "")))
    assert fault.cause == causes.UNKNOWN_HOST
    assert fault.text == ("/planner publishes on /av_turnrad_req from a computer that it calls laptop, which can't be "
                          "looked up here: none of its messages is received. Where /planner runs, set ROS_IP to that "
                          "computer's address, and start it again; if it has ended: rosnode cleanup")


def test_of_two_nodes_none_is_named_as_the_wrong_one():
    fault = second_publisher("channel 0", "2 nodes command channel 0", [PLANNER, TELEOP])
    assert fault.reason.startswith("2 nodes command channel 0, /planner on car and /teleop_logi on car: ")
    assert fault.remedy == "End all but the one that shall command: rosnode kill ends a node"


# --- what is logged ---

WRONG, SECOND = (find_faults(topic(LAPTOPS))[0], find_faults(topic(TELEOP, BY_HAND))[0])


@pytest.mark.parametrize("faults, logged", [
    (lambda second: [WRONG], [0, 10, 20]),
    (lambda second: [WRONG] if second % 2 else [], [1, 11, 21]),
    (lambda second: [SECOND], [5, 15]),
    (lambda second: [SECOND] if second % 5 < 4 else [], []),
], ids=["wrong_type", "wrong_type_that_comes_and_goes", "second_publisher", "second_publisher_that_comes_and_goes"])
def test_wrong_type_is_logged_at_once_and_a_second_publisher_once_it_has_lasted_every_ten_seconds(faults, logged):
    log = FaultLog()
    assert [second for second in range(25) if log.update(faults(second), second * NS_PER_S)] == logged
    assert log.is_lasting(SECOND, 25 * NS_PER_S) == (5 in logged)


@pytest.mark.parametrize("listed, planner", [
    ({"/car1/drive": ["/pursuit"]}, "drive"),
    ({"/car1/cmd_vel": ["/move_base"]}, "cmd_vel"),
    ({"/car1/control/command/gear_cmd": ["/ros_bridge"]}, "autoware"),
    ({"/car1/av_speed_req": ["/net"], "/car1/av_turnrad_req": ["/net"]}, "speed"),
    ({"/car1/drive": ["/pursuit"], "/car1/av_turnrad_req": ["/net"]}, ""),  # turn_arb hears that one
    ({"/car1/drive": ["/pursuit"], "/car1/planner_interface/state": ["/car1/car_nodes"]}, ""),
    ({"/car1/control/command/control_cmd": ["/accelerations"]}, ""),  # the converter takes it
    ({"/drive": ["/another_cars"]}, ""),
    ({}, ""),
])
def test_planner_that_nobody_hears_is_told_with_the_launch_argument(listed, planner):
    faults = find_unheard_planner(listed, lambda name: f"/car1/{name}")
    assert [fault.remedy for fault in faults] == ([f"Start the launch file with planner:={planner}"] if planner else [])
