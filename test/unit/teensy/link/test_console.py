"""Log-in consoles on the Teensy's port."""

import grp
import os

import pytest

from car_interface.teensy.link.console import consoles, is_consoles, removal_remedy


@pytest.fixture
def consoles_port(tmp_path, monkeypatch):
    """A port as agetty leaves it, behind a link, and the group tty; the path of the link."""
    port = tmp_path / "ttyAMA0"
    port.write_text("")
    (tmp_path / "serial0").symlink_to(port)
    status = os.stat_result((0o20620, 3, 26, 1, 0, 5, 0, 0, 0, 0))
    stat = os.stat
    monkeypatch.setattr(os, "stat", lambda path, **how: (
        status if os.path.basename(str(path)) in ("ttyAMA0", "serial0") else stat(path, **how)))
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group(("tty", "x", number, [])))
    return str(tmp_path / "serial0")


def test_console_is_found_by_the_port_s_name_among_its_arguments(tmp_path):
    commands = {5: ["/sbin/agetty", "-o", "-p -- \\u", "--keep-baud", "115200,9600", "ttyACM7", "vt220"],
                6: ["/sbin/agetty", "--noclear", "tty1", "linux"], 7: ["vi", "ttyACM7"], 8: [],
                9: ["getty", "/dev/ttyACM7"]}
    for pid, words in commands.items():
        (tmp_path / str(pid)).mkdir()
        (tmp_path / str(pid) / "cmdline").write_bytes(b"".join(word.encode() + b"\0" for word in words))
    (tmp_path / "10" / "cmdline").mkdir(parents=True)  # can't be read
    assert consoles("/dev/ttyACM7", str(tmp_path)) == [(5, "agetty"), (9, "getty")]
    assert consoles("/dev/ttyACM8", str(tmp_path)) == consoles("/dev/ttyACM7", str(tmp_path / "nowhere")) == []


def test_port_that_a_console_has_is_its_console_s_and_asks_for_no_group_tty(consoles_port):
    assert is_consoles(consoles_port) and "serial-getty@ttyAMA0 " in removal_remedy(consoles_port)


@pytest.mark.parametrize(("mode", "group"), [(0o20660, 5), (0o20620, 20), (0o20600, 987)])
def test_port_that_is_otherwise_is_no_console_s(consoles_port, monkeypatch, mode, group):
    names = {5: "tty", 20: "dialout"}
    monkeypatch.setattr(os, "stat", lambda path, **how: os.stat_result((mode, 3, 26, 1, 0, group, 0, 0, 0, 0)))
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group((names[number], "x", number, [])))
    assert not is_consoles(consoles_port)


def test_pseudo_terminal_is_no_console_s():
    ours, theirs = os.openpty()
    assert not is_consoles(os.ttyname(theirs))
    os.close(ours)
    os.close(theirs)
