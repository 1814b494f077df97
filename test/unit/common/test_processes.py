"""Which processes have a device open."""
import os

import pytest

from car_interface.common.processes import openers, process_name, script_arguments


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
