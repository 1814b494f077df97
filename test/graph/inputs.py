"""The inputs of a node by short names, held, sent once, or silent; and what an arbiter makes of them."""
from __future__ import annotations

import logging
from typing import Any, Callable, Dict, Tuple

from car_interface.msg import Control
from nav_msgs.msg import Odometry

from graph import Graph

Topics = Dict[str, Tuple[str, Callable[[Any], Any]]]


def odometry(speed_mps: float, yaw_rate_radps: float = 0.0) -> Odometry:
    """A speed and how quickly the car turns; its pose doesn't matter."""
    message = Odometry()
    message.twist.twist.linear.x, message.twist.twist.angular.z = speed_mps, yaw_rate_radps
    return message


def control(acceleration: float, angle: float = 0.0, velocity: float = 0.0) -> Control:
    message = Control()
    message.lateral.steering_tire_angle = angle
    message.longitudinal.velocity, message.longitudinal.acceleration = velocity, acceleration
    return message


class Inputs:
    """Inputs that are repeated at 20 Hz while they are held.

    Args:
        topics: by name: the topic, and what makes its message of a value.
        settle_s: the time in which the node has handled a message.
    """

    RATE_HZ = 20

    def __init__(self, graph: Graph, topics: Topics, settle_s: float):
        self.graph, self._topics, self._settle_s = graph, topics, settle_s
        self.run = graph.run

    def hold(self, **inputs: Any) -> None:
        """Repeat these values from now on, and let each arrive."""
        for name, value in inputs.items():
            topic, make = self._topics[name]
            self.graph.hold(topic, make(value), self.RATE_HZ)
        self.run(self._settle_s)

    def once(self, name: str, *values: Any) -> None:
        """Send values, and nothing after them."""
        topic, make = self._topics[name]
        self.graph.silence(topic)
        for value in values:
            self.graph.publish(topic, make(value))

    def silence(self, *names: str) -> None:
        self.graph.silence(*(self._topics[name][0] for name in names))


class Arbiter(Inputs):
    """An arbiter in a graph of its own.

    Args:
        name: of the node, which the test starts.
        channel: of its command.
    """

    def __init__(self, graph: Graph, topics: Topics, settle_s: float, name: str, channel: int):
        super().__init__(graph, topics, settle_s)
        self._name, self._channel, self.start_ns = name, channel, graph.now_ns
        graph.record("/servo/cmdVector", "/servo/neutral")

    @property
    def state(self) -> Any:
        return self.graph.newest(f"/{self._name}/state")

    @property
    def duty(self) -> int:
        return self.graph.newest("/servo/cmdVector").data[self._channel]

    @property
    def now(self) -> tuple:
        """Source, reason and duty; the command has that duty, too."""
        assert self.state.duty == self.duty
        return self.state.source, self.state.reason, self.duty

    def duties(self, since_ns: int = 0) -> list[int]:
        return [vector.data[self._channel] for vector in self.graph.messages("/servo/cmdVector", since_ns)]

    def states(self, since_ns: int) -> list[Any]:
        return self.graph.messages(f"/{self._name}/state", since_ns)

    def warnings(self, since_ns: int = 0) -> list[str]:
        return self.graph.lines(f"/{self._name}", since_ns, logging.WARNING)
