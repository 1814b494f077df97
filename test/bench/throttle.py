"""throttle_arb as turn_arb is measured: latency from an input to /servo/cmdVector, output and CPU time.

It has its shipped configuration. Odometry, turn_arb's state and a servo board that answers are there all the time, and
bare rospy subscribes to them, too.
"""
from __future__ import annotations

from typing import Iterator

from car_interface.msg import Float64Stamped
from std_msgs.msg import Bool, Float32

from .effort import Effort
from .heartbeat import Heartbeat, heartbeat
from .reaction import REACTION, Arbiter, Step, both_ways, reactions
from .rows import Row, Summary
from .stage import Stage

NEUTRAL, BY_HAND = 4915, 5407  # config/throttle.yaml; 0.3 of the way to full forward
VALUES, DUTIES = (1.5, 3.0), (5735, 6554)  # of the converter: half and full forward
REMAPS = ("throttle_arb/input/odometry:=odom", "throttle_arb/input/value:=generic/output/value")
THROTTLE_ARB = Arbiter(
    "throttle_arb", "throttle.yaml", REMAPS, 1,
    {"human": ("/teleop_logi/human_in_loop", Bool), "throttle": ("/teleop_logi/tele_throt_req", Float32),
     "value": ("/generic/output/value", Float64Stamped)},
    {"throttle": 0.0, "human": False},  # the ESC is armed then
    (("human_in_loop false", [Step({"throttle": 1.0, "human": True}, ("human", False), (BY_HAND, NEUTRAL))]),
     ("gamepad's step", both_ways({"human": True}, "throttle", (0.0, 1.0), (NEUTRAL, BY_HAND))),
     ("planner's value", both_ways({"human": True, "throttle": 0.0}, "value", VALUES, DUTIES))),
    ("odometry", "steering_state", "output"))
THROTTLE_ARBS = Heartbeat(
    THROTTLE_ARB, 50, NEUTRAL,
    ("human", "throttle", "mode", "scale_button", "teleop_state", "value", "converter_state", "odometry",
     "steering_state", "output"),
    "the planner drives: deadman, stick, value and odometry at 50 Hz, and what else it gets in a car")


def measure_throttle(effort: Effort, stage: Stage) -> Iterator[Row]:
    for what, times_ms, floors_ms in reactions(effort.reactions, stage, THROTTLE_ARB):
        yield Row("throttle", f"throttle: {what} → /servo/cmdVector", "ms", Summary.of(times_ms), REACTION,
                  Summary.of(floors_ms))
    yield from heartbeat("throttle", THROTTLE_ARBS, effort, stage)
