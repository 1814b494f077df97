"""A car that drives on the test's clock: the story of "How to write a test" in docs/develop.md."""
from car_interface.msg import SteeringState
from std_msgs.msg import Float32

from car import CENTER, ESC, ESC_NEUTRAL, STEERING


def test_car_stands_while_turn_arb_stalls_and_drives_when_it_was_re_armed(car):
    graph = car.whole("speed").graph
    graph.hold("/av_turnrad_req", Float32(2.0), 20, sender="/planner")
    graph.hold("/av_speed_req", Float32(1.0), 20, sender="/planner")
    graph.run(2.5)  # the ESC finds its neutral, and nobody sends an e-stop
    car.pad(autonomous=True)
    graph.run_until(lambda: car.speed_mps > 0.9)
    assert graph.newest("/turn_arb/state").source == SteeringState.PLANNER
    assert car.board.counts[STEERING] < CENTER

    stalled_ns = graph.now_ns
    graph.nodes["/turn_arb"].stall(0.6)
    graph.run(0.6)
    centered_ns, counts = car.board.since(stalled_ns, STEERING)[0]
    assert counts == CENTER
    assert 0.25e9 - 10e6 <= centered_ns - stalled_ns <= 0.25e9  # the servo board's timeout, since the last command
    stopped_ns, counts = car.board.since(stalled_ns, ESC)[-1]
    assert counts == ESC_NEUTRAL
    assert stopped_ns - stalled_ns <= 0.27e9  # throttle_arb's, since turn_arb's last state, and its timer
    graph.run_until(lambda: car.speed_mps == 0.0)

    graph.run(1.0)
    assert graph.newest("/turn_arb/state").reason == "messages were dropped; let go once: publish false, then true"
    assert car.board.counts[:2] == (CENTER, ESC_NEUTRAL)

    car.pad()
    graph.run(0.1)
    car.pad(autonomous=True)
    graph.run_until(lambda: car.speed_mps > 0.9)
    assert car.board.counts[STEERING] < CENTER
