"""When a node may register a name that another node may have, and what it logs meanwhile."""
from __future__ import annotations

import pytest

from car_interface.common.name_wait import FREE, MAX_SILENCE_S, NO_MASTER, RUNNING, SILENT, STARTING, Holder, NameWait
from car_interface.common.units import NS_PER_S

HERE = "127.0.0.1 (this computer)"
NOBODY = Holder(FREE)
RUNS = Holder(RUNNING, HERE, 4711)
HANGS = Holder(SILENT, HERE)
WAITS = ("/turn_arb is already running on 127.0.0.1 (this computer), process 4711. This node waits, and sends nothing, "
         "until that one ends; then it takes over. If a launch file was started twice, end one of the two")


def lines(wait, *answers):
    """What is logged for answers, one a second from a time on."""
    start_ns = 77 * NS_PER_S
    logged = [(second, wait.update(answer, start_ns + second * NS_PER_S)) for second, answer in enumerate(answers)]
    return [each for each in logged if each[1]]


@pytest.fixture
def wait():
    return NameWait("/turn_arb")


@pytest.mark.parametrize("answer", [NOBODY, Holder(NO_MASTER)])
def test_free_name_is_registered_at_once_without_a_word(wait, answer):
    assert lines(wait, answer) == [] and wait.may_register


def test_node_that_runs_is_waited_for_however_long_and_named_at_once_and_every_ten_seconds(wait):
    assert lines(wait, *[RUNS] * 25) == [(0, WAITS), (10, f"{WAITS}; waiting for 10 s so far"),
                                         (20, f"{WAITS}; waiting for 20 s so far")]
    wait.update(RUNS, 10 ** 6 * NS_PER_S)
    assert not wait.may_register


def test_end_of_the_other_node_lets_it_take_over(wait):
    assert lines(wait, RUNS, RUNS, NOBODY) == [
        (0, WAITS), (2, "/turn_arb on 127.0.0.1 (this computer), process 4711 has ended: taking over")]
    assert wait.may_register


def test_another_node_that_took_the_name_meanwhile_is_waited_for(wait):
    other = Holder(RUNNING, "10.0.0.7", 12)
    assert lines(wait, RUNS, *[other] * 10)[1][1].startswith("/turn_arb is already running on 10.0.0.7, process 12.")
    assert not wait.may_register


def test_node_that_does_not_answer_is_replaced_after_ten_seconds(wait):
    logged = lines(wait, *[HANGS] * (MAX_SILENCE_S + 1))
    assert [second for second, _ in logged] == [0, MAX_SILENCE_S]
    assert logged[0][1] == ("/turn_arb is registered on 127.0.0.1 (this computer), and doesn't answer. This node takes "
                            "over if it doesn't for 10 s")
    assert logged[1][1] == ("/turn_arb on 127.0.0.1 (this computer) hasn't answered for 10 s: taking over. If it is "
                            "only frozen, the ROS master ends it when it wakes")
    assert wait.may_register


ABOUT_TO = Holder(STARTING, "this computer")


@pytest.mark.parametrize("answer, logged", [(RUNS, [(0, WAITS)]), (NOBODY, [])])
def test_node_that_is_about_to_register_is_waited_for_without_a_word_until_it_runs_or_gives_up(wait, answer, logged):
    assert lines(wait, *[ABOUT_TO] * MAX_SILENCE_S) == [] and not wait.may_register
    assert lines(wait, answer) == logged and wait.may_register == (answer is NOBODY)


def test_node_that_never_registers_is_replaced_after_ten_seconds(wait):
    logged = lines(wait, *[ABOUT_TO] * (MAX_SILENCE_S + 1))
    assert [second for second, _ in logged] == [MAX_SILENCE_S] and wait.may_register
    assert logged[0][1].startswith("/turn_arb on this computer hasn't answered for 10 s: taking over.")


def test_silence_is_counted_from_the_last_answer_and_the_process_is_still_named(wait):
    logged = lines(wait, *[HANGS] * MAX_SILENCE_S, RUNS, *[HANGS] * MAX_SILENCE_S)
    assert not wait.may_register
    assert "process 4711, and doesn't answer" in logged[-1][1]


def test_master_that_ended_with_the_other_node_is_waited_for(wait):
    logged = lines(wait, RUNS, Holder(NO_MASTER), Holder(NO_MASTER))
    assert len(logged) == 2
    assert logged[1][1] == ("/turn_arb on 127.0.0.1 (this computer), process 4711 has ended, and so has the ROS "
                            "master. This node waits for a master; end its launch file and start it again")
    assert not wait.may_register
    assert "taking over" in lines(wait, NOBODY)[0][1] and wait.may_register
