"""setup_hardware: what it runs, what it shows, and how it ends."""
from __future__ import annotations

import subprocess
import sys

import pytest

from car_interface.tools.host_setup import cli
from car_interface.tools.host_setup.plan import RULES_NAME, Computer

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


LOG_IN, UDEV = "log out and in again", "now also /dev/teensy_sensor_hub"


@pytest.mark.parametrize("failing, code, told, not_told", [
    ((), 0, [LOG_IN, UDEV], ["Not done"]),
    (["usermod"], 1, [UDEV, "sudo gpasswd --add ann GROUP", "Not done: add ann to dialout, i2c, input. "], [LOG_IN]),
    (["groupadd", "install"], 1, [f"Not done: make the group i2c; install /etc/udev/rules.d/{RULES_NAME}. "], [UDEV]),
    (["udevadm"], 0, ["at the next boot"], ["Not done"]),  # which udev does by itself later
], ids=["nothing", "usermod", "groupadd_and_install", "udevadm"])
def test_each_step_is_tried_and_what_failed_is_named_at_the_end(run, failing, code, told, not_told):
    found, ran, said = run(*failing)
    assert (found, ran) == (code, ["groupadd", "usermod", "install", "udevadm", "udevadm"])
    assert [text for text in told if text not in said] == [text for text in not_told if text in said] == []


def test_dry_run_shows_the_commands_and_runs_none(monkeypatch, capsys):
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("it ran something"))
    monkeypatch.setattr(cli, "read_computer", lambda user, rules: COMPUTER)
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "ann", "--dry-run"])
    cli.main()
    assert "usermod --append --groups dialout,i2c,input ann" in capsys.readouterr().out


def test_user_who_does_not_exist_is_told(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "nobody-of-that-name"])
    with pytest.raises(SystemExit, match="there is no user nobody-of-that-name"):
        cli.main()
