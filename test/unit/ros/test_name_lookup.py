"""Who has a node's name, asked of servers that answer as the ROS master and as nodes do."""
from __future__ import annotations

import socket
import threading
from contextlib import contextmanager
from xmlrpc.server import SimpleXMLRPCServer

import pytest

pytest.importorskip("rosgraph")

from car_interface.common.name_wait import FREE, NO_MASTER, RUNNING, SILENT, Holder
from car_interface.ros import name_lookup, xmlrpc_calls
from car_interface.ros.name_lookup import NameLookup, own_name

HERE = "127.0.0.1 (this computer)"


@contextmanager
def serving(**methods):
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        for name, method in methods.items():
            server.register_function(method, name)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


def master(node_uri):
    """The methods of a master that knows /turn_arb at an address, or no node at all."""
    def lookup(caller, name):
        return (1, "", node_uri) if node_uri and name == "/turn_arb" else (-1, "unknown node", "")
    return {"lookupNode": lookup}


def node(name):
    """The methods of a node of rospy; those of roscpp have no getName."""
    methods = {"getPid": lambda caller: (1, "", 4711)}
    return {**methods, "getName": lambda caller: (1, "", name)} if name else methods


def refusing():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}/"


@pytest.fixture(autouse=True)
def impatience(monkeypatch):
    monkeypatch.setattr(xmlrpc_calls, "ANSWER_WITHIN_S", 0.1)
    monkeypatch.setattr(name_lookup, "POLL_S", 0.01)


def holder(node_uri):
    with serving(**master(node_uri)) as master_uri:
        return NameLookup("/turn_arb", master_uri).holder()


def test_name_is_free_that_the_master_does_not_know_or_whose_process_was_killed():
    assert holder("") == holder(refusing()) == Holder(FREE)
    assert NameLookup("/turn_arb", refusing()).holder() == Holder(NO_MASTER)


@pytest.mark.parametrize("name, expected", [
    ("/turn_arb", Holder(RUNNING, HERE, 4711)), ("", Holder(RUNNING, HERE, 4711)), ("/teleop_logi", Holder(FREE))],
    ids=["rospy", "roscpp", "another_node_on_a_dead_one_s_port"])
def test_node_that_answers_is_running_if_it_has_that_name(name, expected):
    with serving(**node(name)) as uri:
        assert holder(uri) == expected


def test_node_that_accepts_and_does_not_answer_or_is_on_an_unknown_computer_is_silent():
    with socket.create_server(("127.0.0.1", 0)) as frozen:
        assert holder(f"http://127.0.0.1:{frozen.getsockname()[1]}/") == Holder(SILENT, HERE)
    assert holder("http://no-such-computer.invalid:1/") == Holder(SILENT, "no-such-computer.invalid")


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
