"""setup_hardware: what it runs, what it shows, and how it ends."""
from __future__ import annotations

import subprocess
import sys

import pytest

from car_interface.host_setup import cli
from car_interface.host_setup.plan import RULES_NAME, Computer

COMPUTER = Computer("ann", frozenset({"dialout", "input"}), frozenset(), has_udev=True, rules_are_new=False)


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs setup_hardware where some programs fail; its exit code, the programs that it ran, and what it printed."""
    def run(*failing):
        ran = []

        def execute(command, **_):
            ran.append(command[0])
            return subprocess.CompletedProcess(command, int(command[0] in failing))
        monkeypatch.setattr(subprocess, "run", execute)
        monkeypatch.setattr(cli, "read_computer", lambda user, rules: COMPUTER)
        monkeypatch.setattr(cli, "as_root", list)
        monkeypatch.setattr(cli, "package_file", lambda name: f"/share/{name}")
        monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "ann"])
        last_words = ""
        try:
            cli.main()
        except SystemExit as end:
            last_words = end.code
        return int(bool(last_words)), ran, capsys.readouterr().out + last_words
    return run


ALL = ["groupadd", "usermod", "install", "udevadm", "udevadm"]


def test_all_that_works_is_done_and_told(run):
    code, ran, said = run()
    assert (code, ran) == (0, ALL)
    assert "log out and in again" in said and "now also /dev/teensy_sensor_hub" in said


def test_user_whom_usermod_does_not_know_gets_the_udev_rule_all_the_same(run):
    code, ran, said = run("usermod")
    assert (code, ran) == (1, ALL)
    assert "sudo gpasswd --add ann GROUP" in said and "Not done: add ann to dialout, i2c, input. " in said
    assert "log out and in again" not in said and "now also /dev/teensy_sensor_hub" in said


def test_each_step_that_failed_is_named_at_the_end(run):
    code, ran, said = run("groupadd", "install")
    assert (code, ran) == (1, ALL)
    assert f"Not done: make the group i2c; install /etc/udev/rules.d/{RULES_NAME}. " in said
    assert "now also /dev/teensy_sensor_hub" not in said


def test_what_udev_does_by_itself_later_is_no_failure(run):
    code, ran, said = run("udevadm")
    assert (code, ran) == (0, ALL)
    assert "at the next boot" in said and "Not done" not in said


def test_dry_run_shows_the_commands_and_runs_none(monkeypatch, capsys):
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("it ran something"))
    monkeypatch.setattr(cli, "read_computer", lambda user, rules: COMPUTER)
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "ann", "--dry-run"])
    cli.main()
    assert "usermod --append --groups dialout,i2c,input ann" in capsys.readouterr().out


def test_help_needs_neither_master_nor_root(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--help"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 0 and "--dry-run" in capsys.readouterr().out


def test_user_who_does_not_exist_is_told(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "nobody-of-that-name"])
    with pytest.raises(SystemExit, match="there is no user nobody-of-that-name"):
        cli.main()
