"""When a node may register a name that another node may have, and what it logs meanwhile."""
from __future__ import annotations

import pytest

from car_interface.common.name_wait import FREE, MAX_SILENCE_S, NO_MASTER, RUNNING, SILENT, STARTING, Holder, NameWait
from car_interface.common.units import NS_PER_S

HERE = "127.0.0.1 (this computer)"
NOBODY, NONE = Holder(FREE), Holder(NO_MASTER)
RUNS, OTHER = Holder(RUNNING, HERE, 4711), Holder(RUNNING, "10.0.0.7", 12)
HANGS, ABOUT_TO = Holder(SILENT, HERE), Holder(STARTING, "this computer")
NAMED = f"/turn_arb on {HERE}, process 4711"
FROZEN = ": taking over. If it is only frozen, the ROS master ends it when it wakes"


def waits(where):
    return (f"/turn_arb is already running on {where}. This node waits, and sends nothing, until that one ends; then "
            "it takes over. If a launch file was started twice, end one of the two")


WAITS = waits(f"{HERE}, process 4711")
MUTE = "and doesn't answer. This node takes over if it doesn't for 10 s"
ENDED = (f"{NAMED} has ended, and so has the ROS master. This node waits for a master; end its launch file and start "
         "it again")


@pytest.mark.parametrize("answers, logged, may_register", [
    ([NOBODY], {}, True),
    ([NONE], {}, True),
    ([RUNS] * 25, {0: WAITS, 10: f"{WAITS}; waiting for 10 s so far", 20: f"{WAITS}; waiting for 20 s so far"}, False),
    ([RUNS, RUNS, NOBODY], {0: WAITS, 2: f"{NAMED} has ended: taking over"}, True),
    ([RUNS, *[OTHER] * 10], {0: WAITS, 10: waits("10.0.0.7, process 12") + "; waiting for 10 s so far"}, False),
    ([HANGS] * 11, {0: f"/turn_arb is registered on {HERE}, {MUTE}",
                    10: f"/turn_arb on {HERE} hasn't answered for 10 s{FROZEN}"}, True),
    ([RUNS, HANGS], {0: WAITS, 1: f"/turn_arb is registered on {HERE}, process 4711, {MUTE}"}, False),
    # one that is about to register, or that gives up before it does, is not mentioned
    ([ABOUT_TO] * 10, {}, False),
    ([*[ABOUT_TO] * 10, RUNS], {10: WAITS}, False),
    ([ABOUT_TO, NOBODY], {}, True),
    ([ABOUT_TO] * 11, {10: f"/turn_arb on this computer hasn't answered for 10 s{FROZEN}"}, True),
    ([RUNS, NONE, NONE], {0: WAITS, 1: ENDED}, False),
    ([RUNS, NONE, NOBODY], {0: WAITS, 1: ENDED, 2: f"{NAMED} has ended: taking over"}, True),
], ids=lambda value: "-".join(each.state for each in value[:3]) if isinstance(value, list) else None)
def test_name_is_registered_once_nobody_has_it_and_what_is_waited_for_is_logged(answers, logged, may_register):
    wait, start_ns = NameWait("/turn_arb"), 77 * NS_PER_S
    found = {second: wait.update(answer, start_ns + second * NS_PER_S) for second, answer in enumerate(answers)}
    assert {second: line for second, line in found.items() if line} == logged
    assert wait.may_register == may_register


def test_silence_is_counted_from_the_last_answer():
    wait = NameWait("/turn_arb")
    for second, answer in enumerate([*[HANGS] * MAX_SILENCE_S, RUNS, *[HANGS] * MAX_SILENCE_S]):
        wait.update(answer, second * NS_PER_S)
    assert not wait.may_register
    wait.update(RUNS, 10 ** 6 * NS_PER_S)  # which is waited for however long
    assert not wait.may_register
