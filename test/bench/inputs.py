"""What the car's nodes receive from others, as often as in a car, and a deadman that they accept."""
from __future__ import annotations

import time
from typing import Any, Callable, NamedTuple

import rospy
from geometry_msgs.msg import Twist, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int8, Int32MultiArray, MultiArrayDimension, MultiArrayLayout, String

from car_interface import msg
from car_interface.common import causes
from car_interface.common.causes import AUTONOMOUS

SPEED_MPS, RADIUS_M = 1.0, 2.0
MAX_SPEED_MPS = 2.83  # in that turn at 4 m/s² sideways: more than the speed, so that no limit is reached
DUTIES = Int32MultiArray(layout=MultiArrayLayout(dim=[MultiArrayDimension("pwm_channel", 16, 1)]), data=[5100] * 16)
RELEASED_STATES = 3  # of an arbiter, the first on the change: messages of the deadman came in between


class Input(NamedTuple):
    """A topic, and what is published on it; ``make`` gets whether the deadman is held."""

    topic: str
    message_type: Any
    make: Callable[[bool], Any]
    rate_hz: int = 50  # a divisor of it


def control(acceleration: float = 0.5) -> msg.Control:
    return msg.Control(stamp=rospy.Time.now(), longitudinal=msg.Longitudinal(acceleration=acceleration))


def odometry() -> Odometry:
    message = Odometry()
    message.header.stamp = rospy.Time.now()
    message.twist.twist.linear.x = SPEED_MPS
    return message


def joy(autonomous: int = 1, manual: int = 0) -> Joy:
    """Return a gamepad with these deadmen held, steering to the left with the manual one."""
    return Joy(axes=[float(manual)] + [0.0] * 7, buttons=[0] * 4 + [manual, autonomous] + [0] * 5)


def twist(speed_mps: float = SPEED_MPS, radius_m: float = RADIUS_M) -> Twist:
    return Twist(linear=Vector3(x=speed_mps), angular=Vector3(z=speed_mps / radius_m))


def steering_state() -> msg.SteeringState:
    return msg.SteeringState(
        stamp=rospy.Time.now(), source=msg.SteeringState.PLANNER, cause=causes.PLANNER,
        reason="av_turnrad_req is 2.000 m", duty=DUTIES.data[0], turn_radius=RADIUS_M, speed=SPEED_MPS,
        asked_radius=RADIUS_M, max_speed=MAX_SPEED_MPS)


def teleop_state(held: bool) -> msg.TeleopState:
    return msg.TeleopState(stamp=rospy.Time.now(), human_in_loop=held, cause=AUTONOMOUS, reason="autonomous deadman")


INPUTS = {
    "human": Input("/teleop_logi/human_in_loop", Bool, bool),
    "steering": Input("/teleop_logi/tele_steer_req", Float32, lambda held: 0.3),
    "throttle": Input("/teleop_logi/tele_throt_req", Float32, lambda held: 0.0),
    "mode": Input("/teleop_logi/mode", String, lambda held: AUTONOMOUS, 10),
    "scale_button": Input("/teleop_logi/scale_button", Int8, lambda held: 0, 10),
    "teleop_state": Input("/teleop_logi/state", msg.TeleopState, teleop_state, 10),
    "radius": Input("/av_turnrad_req", Float32, lambda held: RADIUS_M),
    "acceleration": Input("/control/command/control_cmd", msg.Control, lambda held: control()),
    "twist": Input("/cmd_vel", Twist, lambda held: twist()),
    "value": Input("/generic/output/value", msg.Float64Stamped, lambda held: msg.Float64Stamped(rospy.Time.now(), 1.5)),
    "converter_state": Input("/generic_value_converter/state", msg.ConverterState,
                             lambda held: msg.ConverterState(rospy.Time.now(), 1.5, causes.CONVERTING, ""), 1),
    "odometry": Input("/odom", Odometry, lambda held: odometry()),
    "steering_state": Input("/turn_arb/state", msg.SteeringState, lambda held: steering_state(), 25),
    "joy": Input("/joy", Joy, lambda held: joy(int(held))),
    "output": Input("/servo/output", Int32MultiArray, lambda held: DUTIES, 10),
}
# State, and whether by it the node waits for the deadman alone.
ARBITERS = {
    "turn_arb": (msg.SteeringState, lambda state: state.cause == causes.HUMAN_ABSENT),
    "throttle_arb": (msg.ThrottleState, lambda state: state.cause == causes.HUMAN_ABSENT and state.esc != "ARMING"),
}


def publisher(topic: str, message_type: Any) -> rospy.Publisher:
    return rospy.Publisher(topic, message_type, queue_size=10, tcp_nodelay=True)


class Deadman:
    """Released until some arbiters have seen that: none accepts one that is held at its start."""

    def __init__(self, arbiters: tuple[str, ...]):
        self._states = dict.fromkeys(arbiters, 0)  # of each those that wait for the deadman

    @property
    def is_held(self) -> bool:
        return all(count >= RELEASED_STATES for count in self._states.values())

    def wait(self) -> None:
        subscribers = [rospy.Subscriber(f"/{name}/state", ARBITERS[name][0], self._on_state, name)
                       for name in self._states]
        while not self.is_held and not rospy.is_shutdown():
            time.sleep(0.01)
        for subscriber in subscribers:
            subscriber.unregister()  # one costs the arbiter CPU time

    def _on_state(self, state, name):
        self._states[name] += ARBITERS[name][1](state)
