"""The master, who can reach it, and whether the nodes here can be reached."""
import io
import types

import pytest

from car_interface.tools.doctor import computer
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


@pytest.fixture
def here(monkeypatch):
    """Hosts by name, of which 10.0.0.1 and the loopback are this computer's, which is called car; /proc/net, in which
    nothing listens; and no environment of ROS.
    """
    hosts = {"car": ["10.0.0.1"], "other": ["10.0.0.2"], "localhost": ["127.0.0.1", "::1"],
             **{address: [address] for address in ("127.0.0.1", "10.0.0.1", "1.2.3.4")}}
    tables = {"/proc/net/tcp": "header\n"}

    def getaddrinfo(host, port, **how):
        if host not in hosts:
            raise OSError("unknown host")
        return [(0, 0, 0, "", (address, 0)) for address in hosts[host]]

    def opened(path, encoding):
        if path not in tables:
            raise FileNotFoundError(path)
        return io.StringIO(tables[path])
    monkeypatch.setattr(computer.socket, "getaddrinfo", getaddrinfo)
    monkeypatch.setattr(computer.socket, "gethostname", lambda: "car")
    monkeypatch.setattr(computer, "_is_local", lambda address: address in ("10.0.0.1", "127.0.0.1", "::1"))
    monkeypatch.setattr(computer, "open", opened, raising=False)
    for name in ("ROS_HOSTNAME", "ROS_IP"):
        monkeypatch.delenv(name, raising=False)
    return types.SimpleNamespace(hosts=hosts, tables=tables)


@pytest.mark.parametrize(
    ("port", "addresses"),
    [(11311, ["127.0.0.1", "::"]), (11312, ["0.0.0.0", "::1"]), (11313, ["127.0.0.1"]), (22, ["10.1.2.3"]), (80, [])])
def test_listeners_are_read_from_the_kernels_tables(here, port, addresses):
    here.tables.update({"/proc/net/tcp": TCP, "/proc/net/tcp6": TCP6})
    assert [str(address) for address in computer.listeners(port)] == addresses


@pytest.mark.parametrize("uri, place", [
    ("http://car:11311", ("car", 11311)),
    ("http://[::1]:5", ("::1", 5)),
    ("car:11311", None),
    ("http://:11311", None),
    ("http://car:99999999", None),
    ("http://[::1", None),
])
def test_host_and_port_of_a_uri(uri, place):
    assert computer.host_and_port(uri) == place


ANYWHERE, LOOPBACK, ONE = (f"   0: {address}:2C2F 00000000:0000 0A\n" for address in (
    "00000000", "0100007F", "0302010A"))  # 0x2C2F is port 11311; state 0A listens


@pytest.mark.parametrize("uri, trouble, listening, level, words, remedy", [
    (URI, "", LOOPBACK, OK, "on the loopback only", ""),
    (URI, "", "", OK, "http://127.0.0.1:11311 answers", ""),
    (URI, "", ANYWHERE + LOOPBACK, WARN, "every interface",
     "export ROS_IP=127.0.0.1 ROS_MASTER_URI=http://127.0.0.1:11311; or a firewall or VPN"),
    (URI, "", ONE, WARN, "listens on 10.1.2.3", "VPN"),
    ("http://other:11311", "", "", WARN, "on another host", "VPN"),
    (URI, "Connection refused", "", WARN, "none runs at http://127.0.0.1:11311", "roslaunch starts one"),
    (URI, "timed out", ANYWHERE, BAD, "doesn't answer as a master", "End it"),
    ("http://other:11311", "timed out", "", BAD, "on another host", "ping other"),
    ("http://nowhere:11311", None, "", BAD, "its host, nowhere, can't be found", "/etc/hosts"),
    ("", None, "", BAD, "ROS_MASTER_URI is not set", "setup.bash"),
    ("localhost", None, "", BAD, "which is no master's address", "export ROS_MASTER_URI"),
    ("car:11311", None, "", BAD, "which is no master's address", "export ROS_MASTER_URI"),
], ids=["loopback", "tables_unreadable", "everywhere", "one_interface", "elsewhere", "none", "other",
         "elsewhere_silent", "unknown_host", "unset", "nonsense", "no_scheme"])
def test_master(here, uri, trouble, listening, level, words, remedy):
    """A master of which nobody knows where it is isn't asked: ``trouble`` is None."""
    def ask():
        assert trouble is not None
        return trouble
    here.tables["/proc/net/tcp"] += listening
    found, is_there = computer.probe_network(uri, ask)
    assert found[0].subject == "master" and found[0].level == level and is_there == (trouble == "")
    assert words in found[0].what and remedy in found[0].remedy and bool(found[0].remedy) == (level != OK)


@pytest.mark.parametrize("environment, uri, level, words", [
    ({"ROS_IP": "127.0.0.1"}, MASTER, OK, "ROS_IP, 127.0.0.1: reached from this computer only"),
    ({"ROS_IP": "10.0.0.1"}, "http://other:11311", OK, "ROS_IP, 10.0.0.1"),
    ({"ROS_HOSTNAME": "", "ROS_IP": ""}, MASTER, OK, "this host's name, car"),
    ({"ROS_HOSTNAME": "nowhere"}, "http://other:11311", BAD, "can't be looked up"),
    ({"ROS_IP": "1.2.3.4"}, MASTER, BAD, "isn't this computer's"),
    ({"ROS_HOSTNAME": "localhost"}, "http://other:11311", BAD, "nodes there can't reach those here"),
    ({"ROS_IP": "10.0.0.1", "ROS_HOSTNAME": "car"}, MASTER, WARN, "ROS_HOSTNAME (car) and ROS_IP (10.0.0.1) are both"),
], ids=["loopback", "lan", "host_name", "unknown_name", "foreign", "loopback_but_master_elsewhere", "both"])
def test_own_address(here, monkeypatch, environment, uri, level, words):
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value)
    (_, found), _ = computer.probe_network(uri, str)  # a master that answers is asked by ``str``: no fault
    assert found.subject == "address" and found.level == level
    assert words in found.what and bool(found.remedy) == (level != OK)


def test_computer_without_a_name_is_told(here, monkeypatch):
    monkeypatch.setattr(computer.socket, "gethostname", str)
    (_, found), _ = computer.probe_network(MASTER, str)
    assert (found.level, found.what) == (BAD, "this host has no name, and ROS_IP is not set")
