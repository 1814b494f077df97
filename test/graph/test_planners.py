"""The programs of docs/planners.md, each on a virtual car: what it does with them, and what when they die."""
from __future__ import annotations

import sys
import threading
from types import SimpleNamespace

import pytest

from car import CENTER, ESC, STEERING, Car
from car import ESC_NEUTRAL as NEUTRAL
from car_interface.common import causes
from graph import NS_PER_S, Graph, NodeClocks, TopicPublisher
from pages import DOCS, first_planner


class Program:
    """A program of its own: a rospy script whose ``Rate`` waits for the graph's clock.

    Args:
        monkeypatch: has the script import this in place of rospy.
        name: its node's.
        text: the script's.
    """

    def __init__(self, graph: Graph, monkeypatch, name: str, text: str, *arguments: str):
        self.name, self.last_ns, self._graph, self._is_over = f"/{name}", 0, graph, False
        self._callbacks: dict = {}
        self._goes, self._waits = threading.Semaphore(0), threading.Semaphore(0)
        rospy = SimpleNamespace(
            init_node=lambda name: None, Publisher=self._publisher, Subscriber=self._subscribe, Rate=self._rate,
            Time=SimpleNamespace(now=NodeClocks(graph).ros_now), is_shutdown=lambda: self._is_over,
            ROSInterruptException=KeyError)
        with monkeypatch.context() as patch:  # until the script has imported it, and waits for the first time
            patch.setattr(sys, "argv", [name, *arguments])
            patch.setitem(sys.modules, "rospy", rospy)
            threading.Thread(target=exec, args=(text, {}), daemon=True).start()
            self._waits.acquire()

    def _publisher(self, topic, message_type, queue_size, latch=False):
        topic = f"/{topic}".replace("/control/command/", "/autoware/")
        return TopicPublisher(self._graph, self.name, topic, message_type, latch, NodeClocks(self._graph))

    def _subscribe(self, topic, message_type, callback, argument):
        self._graph.record(f"/{topic}")
        self._callbacks[f"/{topic}"] = lambda message: callback(message, argument)

    def _rate(self, rate_hz):
        def sleep():
            since_ns, self.last_ns = self.last_ns, self._graph.now_ns
            self._graph.after(1 / rate_hz, self._go)
            self._waits.release()
            self._goes.acquire()
            for topic, call in self._callbacks.items():
                for message in self._graph.messages(topic, since_ns):
                    call(message)
        return SimpleNamespace(sleep=sleep)

    def _go(self):
        if not self._is_over:
            self._goes.release()
            self._waits.acquire()

    def kill(self):
        self._is_over = True
        self._goes.release()
        self._graph.drop(self.name)


@pytest.mark.once
@pytest.mark.parametrize("source", ["cmd_vel", "drive"])
def test_first_planner_as_the_page_has_it_drives_to_where_there_is_room_and_hits_nothing(monkeypatch, source):
    car = Car()
    graph = car.graph
    graph.record("/car_sim/collisions", "/planner_interface/state")
    car.whole(source)
    graph.run(1.5)  # the ESC is armed
    car.pad(autonomous=True)
    program = Program(graph, monkeypatch, "first_planner", first_planner(source))
    first_ns = graph.now_ns
    graph.run(10.0)
    twists = [message.twist.twist for message in graph.messages("/car_sim/truth", first_ns)]
    assert max(twist.linear.x for twist in twists) == pytest.approx(0.5, abs=0.08)
    assert any(abs(twist.angular.z) > 0.02 for twist in twists)
    assert graph.newest("/car_sim/collisions").data == 0
    program.kill()
    graph.run_until(lambda: graph.newest("/planner_interface/state").cause == causes.PLANNER_STALE, 0.7)
    graph.run_until(lambda: car.speed_mps == 0.0, 4.0)


@pytest.mark.once
@pytest.mark.parametrize("source, example, arguments, speed, curvature", [
    ("autoware", "autoware_control", (), 1.0, -0.5),
    ("autoware", "autoware_control", ("--back",), -1.0, -0.5),
    ("speed", "end_to_end", (), 0.8, -0.485),  # duty 6652, by the virtual car's own curve
], ids=lambda value: " ".join(value) if isinstance(value, tuple) else None)
def test_example_drives_the_car_and_its_end_stops_it_within_its_timeout(monkeypatch, source, example, arguments, speed,
                                                                        curvature):
    car = Car().whole(source, collisions=False)
    graph = car.graph
    graph.record("/planner_interface/state")
    graph.run(1.5)  # the ESC is armed
    car.pad(autonomous=True)
    text = (DOCS / "examples" / f"{example}.py").read_text(encoding="utf-8")
    program = Program(graph, monkeypatch, example, text, *arguments)
    graph.run(4.0)
    first_ns = graph.now_ns
    graph.run(1.0)
    twists = [message.twist.twist for message in graph.messages("/car_sim/truth", first_ns)]
    assert sum(twist.linear.x for twist in twists) / len(twists) == pytest.approx(speed, rel=0.03)
    # A count of the servo board is a sixth of it where the shipped table is steep.
    assert sum(twist.angular.z / twist.linear.x for twist in twists) / len(twists) == pytest.approx(curvature, rel=0.2)
    assert {message.cause for message in graph.messages("/planner_interface/state", first_ns)} == {"planner"}
    if source == "speed":
        assert graph.newest("/turn_arb/state").reason == "av_steer_req is -0.970"
    program.kill()
    def is_neutral():
        return all(abs(car.board.counts[channel] - rest) <= 1 for channel, rest in ((STEERING, CENTER), (ESC, NEUTRAL)))
    assert 0 < graph.run_until(is_neutral, 1.0) - program.last_ns - NS_PER_S // 2 <= 20e6
    graph.run_until(lambda: car.speed_mps == 0.0, 4.0)
    assert is_neutral()
    assert graph.newest("/planner_interface/state").cause == causes.PLANNER_STALE
    assert graph.newest("/throttle_arb/state").reason.startswith(f"{source} silent for ")
    # It is started again, and drives while the deadman is still held.
    Program(graph, monkeypatch, example, text, *arguments)
    graph.run_until(lambda: abs(car.speed_mps) > 0.3, 2.0)
