"""What the doctor makes of a master's and a node's answers; both are small XML-RPC servers here."""
import os
import shutil
import socket
from contextlib import ExitStack
from types import SimpleNamespace

import pytest
from processes import free_port

from car_interface.common.errors import ConfigError
from car_interface.common.package_files import package_file
from car_interface.tools.doctor import master as probe
from car_interface.tools.doctor.car import ABSENT, KILLED, RUNNING, SILENT, Node
from car_interface.tools.doctor.findings import BAD, OK, WARN
from car_interface.tools.doctor.master import Master, check_files
from loopback import serving


@pytest.fixture
def served():
    with ExitStack() as servers:
        yield lambda **answers: servers.enter_context(serving(**answers))


@pytest.fixture
def node(served):
    return served(getPid=lambda caller: [1, "", 7])


@pytest.fixture
def refused():
    return f"http://127.0.0.1:{free_port()}"


@pytest.fixture
def silent():
    """What takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture
def master(served):
    """Makes a master that knows these nodes by name, and says of which of them the graph consists."""
    def make(uris, graph):
        def look_up(caller, name):
            return [1, "", uris[name]] if name in uris else [-1, f"unknown node [{name}]", ""]
        state = [[["/rosout", list(graph)]], [], []]
        return Master(served(lookupNode=look_up, getSystemState=lambda caller: [1, "", state]))
    return make


def look(master, name="turn_arb", namespace="/"):
    return master.node(name, namespace, *master.graph())


def test_graph_is_who_publishes_subscribes_and_serves(served):
    state = [[["/joy", ["/pad", "/other"]]], [["/joy", ["/teleop_logi"]]], [["/turn_arb/save", ["/turn_arb"]]]]
    graph = Master(served(getSystemState=lambda caller: [1, "", state])).graph()
    assert graph == ({"/joy": ("/pad", "/other")}, frozenset({"/pad", "/other", "/teleop_logi", "/turn_arb"}))


def test_node_that_ended_is_absent_without_an_answer_silent_and_where_nobody_listens_killed(master, refused, silent):
    assert look(master({"/turn_arb": refused}, [])).state == ABSENT
    for uri in (silent, "http://no-such-host.invalid:1"):
        assert look(master({"/turn_arb": uri}, ["/turn_arb"])).state == SILENT
    assert look(master({"/turn_arb": refused}, ["/turn_arb"])).state == KILLED
    found = look(master({"/car_nodes": refused}, ["/car_nodes"]))
    assert (found.state, found.process) == (KILLED, "/car_nodes")


@pytest.mark.parametrize("name, process", [("turn_arb", "/car_nodes"), ("teleop_logi", "/teleop_logi")])
def test_four_of_the_nodes_may_be_parts_of_one_process_that_runs(name, process, master, node):
    found = look(master({"/car1/car_nodes": node}, ["/car1/car_nodes"]), name, "/car1")
    assert found == (name, f"/car1/{name}", RUNNING if name == "turn_arb" else ABSENT, f"/car1{process}")


@pytest.fixture
def launched(monkeypatch):
    """The arguments of the node's process, by the name of its script."""
    arguments = {}
    monkeypatch.setattr(probe, "script_arguments",
                        lambda pid, script: arguments.get(script, []) if pid == 7 else [])
    return arguments


@pytest.mark.parametrize("process, arguments", [
    ("pca9685", ["--device", "virtual", "__name:=pca9685"]),
    ("car_nodes", ["--device", "virtual", "--port", "/tmp/a", "--throttle", "true"]),
])
def test_parameters_that_a_launch_file_fixed_are_known_when_they_are_lost(master, node, launched, process, arguments):
    launched[process] = arguments
    asked = master({f"/{process}": node}, [f"/{process}"])
    board = look(asked, "pca9685")
    assert asked.fixed_parameters(board) == {"device": "virtual"}
    asked.parameter = lambda path: None
    car = SimpleNamespace(master=asked, nodes={"pca9685": board}, known_text=lambda *_: None)
    found, = probe.check_parameters(car)
    assert found.what == ("/pca9685: it will not start again with these: device is missing; accepted: virtual, by the "
                          "launch file that started this process")


def test_nothing_is_known_of_a_process_on_another_computer_or_with_wrong_arguments(master, node, launched, monkeypatch):
    asked = master({"/pca9685": node}, ["/pca9685"])
    launched["pca9685"] = ["--devise", "virtual"]
    assert asked.fixed_parameters(look(asked, "pca9685")) == {}
    launched["pca9685"] = ["--device", "virtual"]
    monkeypatch.setattr(probe, "leads_here", lambda host: False)
    assert asked.fixed_parameters(look(asked, "pca9685")) == {}


# --- parameters ---

MINE, PACKAGE = "/home/me/my_car", os.path.realpath(package_file("config"))


@pytest.fixture
def judge(monkeypatch):
    """The findings about nodes, by what the server holds for each; a "fault" among that is one to the node."""
    def read_all(params, config):
        fault = params.text("fault", None)
        if fault:
            raise ConfigError("fault", fault, "none")
    monkeypatch.setattr(probe, "read_all", read_all)

    def judge(states=(), is_virtual=False, **private):
        master = SimpleNamespace(parameter=lambda path: private.get(path[1:]), search_parents=lambda *_: None,
                                 fixed_parameters=lambda node: {})
        nodes = {name: Node(name, f"/{name}", dict(states).get(name, RUNNING), f"/{name}") for name in private}
        device = "virtual" if is_virtual else "/dev/i2c-1"
        return [(one.level, one.subject, one.what, one.remedy) for one in probe.check_parameters(
            SimpleNamespace(master=master, nodes=nodes, known_text=lambda node, name: device))]
    return judge


def test_good_parameters_are_one_line_and_none_is_how_it_is_before_the_launch(judge):
    found, = judge(turn_arb={}, pca9685=None, teleop_logi=None, states={"teleop_logi": ABSENT})
    assert found[:3] == (OK, "parameters", "those of /turn_arb, /pca9685 are good")
    found, = judge(turn_arb=None, states={"turn_arb": ABSENT})
    assert found[:3] == (OK, "parameters", "none on the server; launch files bring them")


@pytest.mark.parametrize(("state", "words"), [(RUNNING, "it will not start again"), (ABSENT, "it can't start")])
def test_bad_parameter_is_told_in_the_nodes_own_words(judge, state, words):
    good, found = judge(pca9685={}, turn_arb={"fault": "x"}, states={"turn_arb": state})
    assert (good[0], found[0]) == (OK, BAD)
    assert found[2] == f"/turn_arb: {words} with these: fault is 'x'; accepted: none" and "YAML" in found[3]


@pytest.mark.parametrize(("folders", "is_virtual", "level", "text"), [
    ({"turn_arb": MINE, "pca9685": MINE}, False, OK, f"all nodes were launched with {MINE}"),
    ({"turn_arb": MINE, "pca9685": PACKAGE}, False, WARN,
     f"the nodes were launched with different folders: /turn_arb: {MINE}; /pca9685: {PACKAGE}"),
    ({"turn_arb": PACKAGE, "pca9685": PACKAGE}, False, WARN,
     f"the nodes were launched with the package's own files, {PACKAGE}"),
    ({"turn_arb": PACKAGE}, True, OK, f"all nodes were launched with {PACKAGE}"),
], ids=["one_folder", "two_folders", "the_package_s_on_a_car", "the_package_s_on_a_virtual_car"])
def test_folder_of_the_nodes_files_is_compared(judge, folders, is_virtual, level, text):
    _, found = judge(is_virtual=is_virtual, **{node: {"config_folder": folder} for node, folder in folders.items()})
    assert found[:3] == (level, "files", text)
    assert level == OK or "roslaunch ignores an argument that is misspelt" in found[3]


# --- files ---

@pytest.fixture
def car(tmp_path, served):
    """A car's folder, and its faults by a master that knows where turn_arb saves."""
    folder = tmp_path / "my_car"
    shutil.copytree(str(package_file("config")), str(folder))

    def faults(save_to):
        def parameter(caller, name):
            return [1, "", str(save_to)] if name == "/turn_arb/save_to" else [-1, "not set", ""]
        nodes = {name: Node(name, f"/{name}", RUNNING, f"/{name}") for name in ("pca9685", "turn_arb")}
        return check_files(SimpleNamespace(master=Master(served(getParam=parameter)), nodes=nodes))
    return folder, faults


def test_files_of_the_folder_that_a_node_saves_to_are_read(car):
    folder, faults = car
    assert faults(folder / "turn_arb.yaml") == []
    with open(str(folder / "sonars.yaml"), "a", encoding="utf-8") as file:
        file.write("sonar_left: !degrees 3\nsonar_left: 2\n")
    (folder / "notes.yaml").write_text("a: 1\na: 2\n")  # of the owner's own
    os.unlink(str(folder / "pca9685.yaml"))
    os.mkfifo(str(folder / "pca9685.yaml"))
    found = faults(folder / "turn_arb.yaml")
    assert {(one.level, one.subject) for one in found} == {(WARN, "files")}
    assert all("takes the last of two values without a word" in one.remedy for one in found)
    pipe, twice = sorted(one.what for one in found)
    assert pipe.startswith(f"{folder}/pca9685.yaml can't be read (it is a pipe)")
    assert twice.startswith(f"{folder}/sonars.yaml, lines ") and "both give sonar_left" in twice
