"""The master, who can reach it, and whether the nodes here can be reached."""
import io
import types

import pytest

from car_interface.tools.doctor import network
from car_interface.tools.doctor.findings import BAD, OK, WARN

MASTER = "http://car:11311"
URI = "http://127.0.0.1:11311"
# 127.0.0.1:11311, 0.0.0.0:11312, 10.1.2.3:22 all listening, and a connection to 127.0.0.1:11311.
TCP = """\
  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode
   0: 0100007F:2C2F 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 1 1 0 100 0 0 10 0
   1: 00000000:2C30 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 2 1 0 100 0 0 10 0
   2: 0302010A:0016 00000000:0000 0A 00000000:00000000 00:00000000 00000000     0        0 3 1 0 100 0 0 10 0
   3: 0302010A:2C2F 0100007F:9C40 01 00000000:00000000 00:00000000 00000000     0        0 4 1 0 100 0 0 10 0
"""
# [::]:11311, [::1]:11312 and [::ffff:127.0.0.1]:11313 listening.
TCP6 = """\
  sl  local_address                         remote_address                        st
   0: 00000000000000000000000000000000:2C2F 00000000000000000000000000000000:0000 0A 0 0 0 0 0
   1: 00000000000000000000000001000000:2C30 00000000000000000000000000000000:0000 0A 0 0 0 0 0
   2: 0000000000000000FFFF00000100007F:2C31 00000000000000000000000000000000:0000 0A 0 0 0 0 0
"""


@pytest.mark.parametrize(
    ("port", "addresses"),
    [(11311, ("127.0.0.1", "::")), (11312, ("0.0.0.0", "::1")), (11313, ("127.0.0.1",)), (22, ("10.1.2.3",)), (80, ())])
def test_listeners_are_read_from_the_kernels_tables(port, addresses):
    assert network.listeners([TCP, TCP6], port) == addresses


@pytest.mark.parametrize("uri, place", [
    ("http://car:11311", ("car", 11311)),
    ("http://[::1]:5", ("::1", 5)),
    ("car:11311", None),
    ("http://:11311", None),
    ("http://car:99999999", None),
    ("http://[::1", None),
])
def test_host_and_port_of_a_uri(uri, place):
    assert network.host_and_port(uri) == place


@pytest.mark.parametrize("master, level, words, remedy", [
    ((URI, "", True, ("127.0.0.1",)), OK, "on the loopback only", ""),
    ((URI, "", True, ()), OK, "answers", ""),
    ((URI, "", True, ("0.0.0.0", "127.0.0.1")), WARN, "every interface", "ROS_IP=127.0.0.1"),
    ((URI, "", True, ("10.1.2.3",)), WARN, "listens on 10.1.2.3", "VPN"),
    (("http://car:11311", "", False), WARN, "on another host", "VPN"),
    ((URI, "Connection refused", True), WARN, "none runs at", "roslaunch starts one"),
    ((URI, "timed out", True, ("0.0.0.0",)), BAD, "doesn't answer as a master", "End it"),
    (("http://car:11311", "timed out", False), BAD, "on another host", "ping car"),
    (("http://car:11311", "no", None), BAD, "can't be found", "/etc/hosts"),
    (("", "no"), BAD, "not set", "setup.bash"),
    (("localhost", "no"), BAD, "no master's address", "export ROS_MASTER_URI"),
], ids=["loopback", "tables_unreadable", "everywhere", "one_interface", "elsewhere", "none", "other",
         "elsewhere_silent", "unknown_host", "unset", "nonsense"])
def test_master(master, level, words, remedy):
    found, = network.check_master(*master)
    assert found.level == level
    assert words in found.what and remedy in found.remedy and bool(found.remedy) == (level != OK)


def address(name="10.0.0.1", resolves=True, is_here=True, is_loopback=False):
    return name, is_here if resolves else None, is_loopback


@pytest.mark.parametrize("environment, own, master_is_here, level, words", [
    ({"ROS_IP": "127.0.0.1"}, address("127.0.0.1", is_loopback=True), True, OK, "this computer only"),
    ({"ROS_IP": "10.0.0.1"}, address(), False, OK, "ROS_IP, 10.0.0.1"),
    ({}, address("car"), True, OK, "this host's name, car"),
    ({}, address("car", resolves=False), True, BAD, "can't be looked up"),
    ({}, address(""), True, BAD, "has no name"),
    ({"ROS_IP": "1.2.3.4"}, address("1.2.3.4", is_here=False), True, BAD, "isn't this computer's"),
    ({"ROS_IP": "127.0.0.1"}, address("127.0.0.1", is_loopback=True), False, BAD, "on another host"),
    ({"ROS_IP": "10.0.0.1", "ROS_HOSTNAME": "car"}, address("car"), True, WARN, "the first one counts"),
], ids=["loopback", "lan", "host_name", "unknown_name", "no_name", "foreign", "loopback_but_master_elsewhere", "both"])
def test_own_address(environment, own, master_is_here, level, words):
    found, = network.check_local_address(environment, master_is_here, *own)
    assert found.level == level and words in found.what and bool(found.remedy) == (level != OK)


# --- as it is on this computer ---

@pytest.fixture
def hosts_here(monkeypatch):
    """Hosts by name, of which 10.0.0.1 and the loopback are this computer's; /proc/net is empty. A master that answers
    is asked by ``str``: no fault.
    """
    hosts = {"car": ["10.0.0.1"], "other": ["10.0.0.2"], "localhost": ["127.0.0.1", "::1"]}
    tables = {"/proc/net/tcp": "header\n"}

    def getaddrinfo(host, port, **how):
        if host not in hosts:
            raise OSError("unknown host")
        return [(0, 0, 0, "", (address, 0)) for address in hosts[host]]

    def opened(path, encoding):
        if path not in tables:
            raise FileNotFoundError(path)
        return io.StringIO(tables[path])
    monkeypatch.setattr(network.socket, "getaddrinfo", getaddrinfo)
    monkeypatch.setattr(network.socket, "gethostname", lambda: "car")
    monkeypatch.setattr(network, "_is_local", lambda address: address in ("10.0.0.1", "127.0.0.1", "::1"))
    monkeypatch.setattr(network, "open", opened, raising=False)
    for name in ("ROS_HOSTNAME", "ROS_IP"):
        monkeypatch.delenv(name, raising=False)
    return types.SimpleNamespace(hosts=hosts, tables=tables)


def test_master_on_this_computer_that_answers_is_ok_unless_it_listens_on_every_interface(hosts_here):
    master, address, is_there = network.probe_network(MASTER, str)
    assert is_there and [(one.level, one.what) for one in master] == [(OK, "http://car:11311 answers")]
    assert [(one.level, one.what) for one in address] == [(OK, "this host's name, car")]
    (found,), _, is_there = network.probe_network(MASTER, lambda: "Connection refused")
    assert not is_there and (found.level, found.what.split(";")[0]) == (WARN, "none runs at http://car:11311")
    # 0x2C2F is port 11311; state 0A listens.
    hosts_here.tables["/proc/net/tcp"] += "   0: 00000000:2C2F 00000000:0000 0A\n"
    (found,), _, _ = network.probe_network(MASTER, str)
    assert found.level == WARN and "listens on every interface" in found.what


@pytest.mark.parametrize("environment, name", [
    ({"ROS_HOSTNAME": "car", "ROS_IP": "10.0.0.1"}, "ROS_HOSTNAME (car) and ROS_IP (10.0.0.1)"),
    ({"ROS_IP": "10.0.0.1"}, "ROS_IP, 10.0.0.1"), ({"ROS_HOSTNAME": "", "ROS_IP": ""}, "this host's name, car")])
def test_own_name_is_found_as_ros_finds_it(hosts_here, monkeypatch, environment, name):
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value)
    _, (found,), _ = network.probe_network(MASTER, str)
    assert found.what.startswith(name)


def test_master_on_another_host_is_named_and_needs_an_address_that_is_reached_from_there(hosts_here, monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    (master,), (address,), is_there = network.probe_network("http://other:11311", str)
    assert is_there and (master.level, address.level) == (WARN, BAD)
    assert "is on another host" in master.what and "nodes there can't reach those here" in address.what
    for name, what in (("nowhere", "can't be looked up"), ("other", "isn't this computer's")):
        monkeypatch.setenv("ROS_HOSTNAME", name)
        _, (found,), _ = network.probe_network(MASTER, str)
        assert found.level == BAD and what in found.what


@pytest.mark.parametrize("uri, what", [
    ("http://nowhere:11311", "its host, nowhere, can't be found"), ("", "ROS_MASTER_URI is not set"),
    ("car:11311", "which is no master's address")])
def test_master_whose_host_is_unknown_is_not_asked(hosts_here, uri, what):
    def asked():
        raise AssertionError("asked")
    (found,), _, is_there = network.probe_network(uri, asked)
    assert not is_there and found.level == BAD and what in found.what
