"""The master, who can reach it, and whether the nodes here can be reached."""
from __future__ import annotations

import pytest

from car_interface.tools.doctor.checks import network
from car_interface.tools.doctor.checks.findings import BAD, OK, WARN

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
    (network.MasterAddress(URI, "", True, ("127.0.0.1",)), OK, "on the loopback only", ""),
    (network.MasterAddress(URI, "", True, ()), OK, "answers", ""),
    (network.MasterAddress(URI, "", True, ("0.0.0.0", "127.0.0.1")), WARN, "every interface", "ROS_IP=127.0.0.1"),
    (network.MasterAddress(URI, "", True, ("10.1.2.3",)), WARN, "listens on 10.1.2.3", "VPN"),
    (network.MasterAddress("http://car:11311", "", False), WARN, "on another host", "VPN"),
    (network.MasterAddress(URI, "Connection refused", True), WARN, "none runs at", "roslaunch starts one"),
    (network.MasterAddress(URI, "timed out", True, ("0.0.0.0",)), BAD, "doesn't answer as a master", "End it"),
    (network.MasterAddress("http://car:11311", "timed out", False), BAD, "on another host", "ping car"),
    (network.MasterAddress("http://car:11311", "no", None), BAD, "can't be found", "/etc/hosts"),
    (network.MasterAddress("", "no"), BAD, "not set", "setup.bash"),
    (network.MasterAddress("localhost", "no"), BAD, "no master's address", "export ROS_MASTER_URI"),
], ids=["loopback", "tables_unreadable", "everywhere", "one_interface", "elsewhere", "none", "other",
         "elsewhere_silent", "unknown_host", "unset", "nonsense"])
def test_master(master, level, words, remedy):
    found, = network.check_master(master)
    assert found.level == level
    assert words in found.what and remedy in found.remedy and bool(found.remedy) == (level != OK)


def test_own_name_is_found_as_ros_finds_it():
    both = {"ROS_HOSTNAME": "car", "ROS_IP": "10.0.0.1"}
    assert network.local_name(both, "host") == "car"
    assert network.local_name({"ROS_IP": "10.0.0.1"}, "host") == "10.0.0.1"
    assert network.local_name({"ROS_HOSTNAME": "", "ROS_IP": ""}, "host") == "host"


def address(name="10.0.0.1", resolves=True, is_here=True, is_loopback=False):
    return network.LocalAddress(name, resolves, is_here, is_loopback)


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
    found, = network.check_local_address(environment, own, master_is_here)
    assert found.level == level and words in found.what and bool(found.remedy) == (level != OK)
