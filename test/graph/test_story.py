"""A car that drives on the test's clock."""
from __future__ import annotations

from car_interface.msg import SteeringState
from std_msgs.msg import Float32

from car import CENTER, STEERING


def test_car_stands_while_turn_arb_stalls_and_drives_when_it_was_re_armed(car):
    graph = car.whole().graph
    graph.run(1.0)
    graph.repeat("/av_turnrad_req", Float32(2.0), 20, sender="/planner")
    car.pad(autonomous=True)
    graph.run_until(lambda: graph.newest("/turn_arb/state").source == SteeringState.PLANNER, 1.0)
    graph.run(0.1)
    assert car.board.counts[STEERING] < CENTER
    stalled_ns = graph.now_ns
    graph.nodes["/turn_arb"].stall(0.6)
    graph.run(0.6)
    centered_ns, counts = car.board.since(stalled_ns, STEERING)[0]
    assert counts == CENTER
    assert 0.25e9 - 20e6 <= centered_ns - stalled_ns <= 0.25e9
    graph.run(0.5)
    assert car.board.counts[STEERING] == CENTER
    car.pad()
    graph.run(0.5)
    car.pad(autonomous=True)
    graph.run(0.5)
    assert car.board.counts[STEERING] < CENTER
