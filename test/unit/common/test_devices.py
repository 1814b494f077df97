"""Why a device refuses its user, and what gives access; modes, groups and users are made up."""
import grp
import os
import pwd

import pytest

from car_interface.common.devices import (
    SETUP_COMMAND,
    explain_denial,
    openers,
    process_name,
    read_membership,
    script_arguments,
)

OPEN_TO_GROUP, OWNERS_ONLY = 0o20660, 0o20600


@pytest.fixture
def computer(monkeypatch):
    """Sets the device's mode and group, this process's groups and the members of dialout in /etc/group."""
    def set_up(mode=OPEN_TO_GROUP, gid=20, of_process=(), members=()):
        groups = [grp.struct_group(("dialout", "x", 20, list(members))), grp.struct_group(("root", "x", 0, [])),
                  grp.struct_group(("ann", "x", 1000, []))]
        by_number = {group.gr_gid: group for group in groups}
        monkeypatch.setattr(os, "stat", lambda path: os.stat_result((mode, 3, 26, 1, 0, gid, 0, 0, 0, 0)))
        monkeypatch.setattr(os, "getgroups", lambda: list(of_process))
        monkeypatch.setattr(os, "geteuid", lambda: 1000)
        monkeypatch.setattr(os, "getegid", lambda: 1000)
        monkeypatch.setattr(grp, "getgrgid", lambda number: by_number[number])
        monkeypatch.setattr(grp, "getgrall", lambda: groups)
        monkeypatch.setattr(pwd, "getpwuid", lambda number: pwd.struct_passwd(("ann", "x", number, 1000, "", "", "")))
    return set_up


@pytest.mark.parametrize("facts, cause, remedy", [
    ({}, "ann is not in its group, dialout", SETUP_COMMAND),
    ({"members": ["ann"]}, "ann joined its group, dialout, after logging in", "Log in anew"),
    ({"of_process": [20]}, "in spite of its group, dialout", "ls -lL /dev/x"),
    ({"mode": OWNERS_ONLY}, "nor has its group, dialout", SETUP_COMMAND),
    ({"gid": 0}, "open to root only", SETUP_COMMAND),
    ({"gid": 987}, "ann is not in its group, 987", "sudo usermod -aG 987 ann"),
], ids=str)
def test_denial_is_explained_with_its_remedy(computer, facts, cause, remedy):
    computer(**facts)
    explained = explain_denial("/dev/x")
    assert explained[0].startswith("no permission to open it") and cause in explained[0] and remedy in explained[1]


def test_device_that_has_gone_meanwhile_is_explained_too():
    assert explain_denial("/nowhere/at/all") == ("no permission to open it", f"{SETUP_COMMAND}, then log in anew")


def test_membership_tells_the_groups_of_the_process_from_those_of_the_next_log_in(computer):
    computer(members=["ann"])
    found = read_membership()
    assert (found.user, found.is_root, found.of_process) == ("ann", False, {"ann"})
    assert found.of_user == {"ann", "dialout"} and found.existing == {"ann", "dialout", "root"}


def test_user_without_a_name_is_known_by_number(computer, monkeypatch):
    def getpwuid(number):
        raise KeyError(number)
    computer(gid=20)
    monkeypatch.setattr(pwd, "getpwuid", getpwuid)
    assert read_membership().user == "1000"
    assert "1000 is not in its group" in explain_denial("/dev/x")[0]


# --- which processes have a device open ---

@pytest.fixture
def proc(tmp_path):
    """A /proc in which process 7, a script, has a device open by a link, and process 8 something else."""
    device = tmp_path / "ttyACM0"
    device.write_text("")
    (tmp_path / "by-id").symlink_to(device)
    for pid, target, words in ((7, device, ["/usr/bin/python3", "-u", "/opt/pca9685"]), (8, "/dev/null", ["agetty:"])):
        (tmp_path / "proc" / str(pid) / "fd").mkdir(parents=True)
        (tmp_path / "proc" / str(pid) / "fd" / "3").symlink_to(target)
        (tmp_path / "proc" / str(pid) / "cmdline").write_bytes(b"\0".join(word.encode() for word in words) + b"\0")
    (tmp_path / "proc" / "9").mkdir()
    (tmp_path / "proc" / "uptime").write_text("")
    return tmp_path


def test_openers_are_found_through_links_and_processes_that_hide_or_have_ended_are_passed_over(proc):
    assert openers(str(proc / "by-id"), str(proc / "proc")) == [(7, "pca9685")]
    assert openers(str(proc / "ttyACM1"), str(proc / "proc")) == []
    assert openers(str(proc / "by-id"), str(proc / "nowhere")) == []
    assert process_name(8, str(proc / "proc")) == "agetty"
    assert process_name(9, str(proc / "proc")) == "unknown"


def test_this_process_is_not_among_the_openers(tmp_path):
    with open(tmp_path / "port", "w", encoding="ascii") as file:
        assert os.readlink(f"/proc/self/fd/{file.fileno()}") == str(tmp_path / "port")
        assert openers(str(tmp_path / "port")) == []


def test_arguments_of_a_script_are_those_behind_it(proc):
    words = ["/usr/bin/python3", "-u", "/opt/pca9685", "--port", "", "__name:=a"]
    (proc / "proc" / "7" / "cmdline").write_bytes(b"\0".join(word.encode() for word in words) + b"\0")
    assert script_arguments(7, "pca9685", str(proc / "proc")) == ["--port", "", "__name:=a"]
    assert script_arguments(7, "car_nodes", str(proc / "proc")) == []
    assert script_arguments(9, "pca9685", str(proc / "proc")) == []
