"""When a node may register a name that another node may have, asked of servers that answer as master and nodes do."""
import socket
from types import SimpleNamespace

import pytest
from processes import free_port

pytest.importorskip("rosgraph")

from car_interface.common.units import NS_PER_S
from car_interface.ros import wait_for_name, xmlrpc_calls
from car_interface.ros.wait_for_name import (
    FREE,
    MAX_SILENCE_S,
    NO_MASTER,
    RUNNING,
    SILENT,
    STARTING,
    Holder,
    NameLookup,
    NameWait,
    own_name,
)
from loopback import serving

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
    ([RUNS, Holder(SILENT, "10.0.0.7")], {0: WAITS, 1: f"/turn_arb is registered on 10.0.0.7, {MUTE}"}, False),
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


def master(node_uri):
    """The methods of a master that knows /turn_arb at an address, or no node at all."""
    def lookup(caller, name):
        return (1, "", node_uri) if node_uri and name == "/turn_arb" else (-1, "unknown node", "")
    return {"lookupNode": lookup}


def node(name):
    """The methods of a node of rospy; those of roscpp have no getName."""
    methods = {"getPid": lambda caller: (1, "", 4711)}
    return {**methods, "getName": lambda caller: (1, "", name)} if name else methods


@pytest.fixture(autouse=True)
def impatience(monkeypatch):
    monkeypatch.setattr(xmlrpc_calls, "ANSWER_WITHIN_S", 30.0)  # of servers in threads on a busy computer
    monkeypatch.setattr(wait_for_name, "POLL_S", 0.01)


def holder(node_uri):
    with serving(**master(node_uri)) as master_uri:
        return NameLookup("/turn_arb", master_uri).holder()


def test_name_is_free_unless_its_node_accepts_and_does_not_answer_or_is_on_an_unknown_computer(monkeypatch):
    assert holder("") == holder(f"http://127.0.0.1:{free_port()}/") == Holder(FREE)
    assert NameLookup("/turn_arb", f"http://127.0.0.1:{free_port()}/").holder() == Holder(NO_MASTER)
    monkeypatch.setattr(xmlrpc_calls, "ANSWER_WITHIN_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as frozen:
        assert holder(f"http://127.0.0.1:{frozen.getsockname()[1]}/") == Holder(SILENT, HERE)
    assert holder("http://no-such-computer.invalid:1/") == Holder(SILENT, "no-such-computer.invalid")


@pytest.mark.parametrize("name, expected", [
    ("/turn_arb", Holder(RUNNING, HERE, 4711)), ("", Holder(RUNNING, HERE, 4711)), ("/teleop_logi", Holder(FREE))],
    ids=["rospy", "roscpp", "another_node_on_a_dead_one_s_port"])
def test_node_that_answers_is_running_if_it_has_that_name(name, expected):
    with serving(**node(name)) as uri:
        assert holder(uri) == expected


def test_node_is_asked_when_the_master_is_gone():
    with serving(**node("/turn_arb")) as uri:
        with serving(**master(uri)) as master_uri:
            lookup = NameLookup("/turn_arb", master_uri)
            assert lookup.holder().state == RUNNING
        assert lookup.holder().state == RUNNING
    assert lookup.holder() == Holder(NO_MASTER)


@pytest.mark.parametrize(("arguments", "namespace", "name"), [
    ([], "", "/turn_arb"), (["__name:=other"], "", "/other"), (["__ns:=car2", "a:=b"], "", "/car2/turn_arb"),
    ([], "/car1", "/car1/turn_arb"), (["__ns:=/a/b", "__name:=c"], "/car1", "/a/b/c")])
def test_own_name_is_that_of_ros(monkeypatch, arguments, namespace, name):
    monkeypatch.setenv("ROS_NAMESPACE", namespace)
    assert own_name("turn_arb", ["turn_arb", *arguments]) == name


@pytest.fixture
def waiting(monkeypatch):
    """Wait for /turn_arb while the master answers with holders, one at each poll; what is done in each pause."""
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{free_port()}/")
    now_ns, pauses = 0, []

    def wait(holders, in_pause):
        answers = iter(holders)

        def sleep(seconds):
            nonlocal now_ns
            now_ns += round(seconds * NS_PER_S)
            pauses.append(seconds)
            in_pause(len(pauses))
        monkeypatch.setattr(wait_for_name, "SYSTEM", SimpleNamespace(now_ns=lambda: now_ns, sleep=sleep))
        monkeypatch.setattr(NameLookup, "holder", lambda self: next(answers))
        return wait_for_name.wait_for_name("/turn_arb"), pauses
    return wait


def is_claimed(name="/turn_arb"):
    claim = wait_for_name._claim(name)
    if claim is not None:
        claim.close()
    return claim is None


def test_free_name_is_claimed_at_once_and_until_the_node_has_registered(waiting):
    claim, pauses = waiting([NOBODY], None)
    assert is_claimed() and not is_claimed("/pca9685") and pauses == []
    claim.close()
    assert not is_claimed()


def test_name_that_a_running_node_has_is_not_claimed_until_it_ends_and_standard_error_says_so(waiting, capsys):
    claimed = []
    claim, pauses = waiting([RUNS, RUNS, NOBODY], lambda count: claimed.append(is_claimed()))
    assert claimed == [False, False] and pauses == [0.01, 0.01]
    first, last = capsys.readouterr().err.splitlines()
    assert "[WARN]" in first and WAITS in first and f"{NAMED} has ended: taking over" in last
    with claim:
        assert is_claimed()


def test_name_that_another_node_of_this_computer_has_claimed_is_waited_for(waiting):
    other = wait_for_name._claim("/turn_arb")
    claim, pauses = waiting([NOBODY] * 3, lambda count: other.close() if count == 2 else None)
    with claim:
        assert len(pauses) == 2 and is_claimed()


def test_name_that_is_claimed_for_ten_seconds_is_taken_over(waiting, monkeypatch):
    monkeypatch.setattr(wait_for_name, "POLL_S", 5.0)
    with wait_for_name._claim("/turn_arb"):
        claim, pauses = waiting([NOBODY] * 3, lambda count: None)
        assert len(pauses) == 2 and claim.fileno() >= 0
        claim.close()


def test_name_of_any_length_can_be_claimed(waiting):
    name = "/car" * 50
    with wait_for_name._claim(name):
        assert is_claimed(name)
