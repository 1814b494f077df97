"""The doctor's command line, and how its findings are shown."""
import io
import sys
import types

import pytest

from car_interface.tools.doctor import cli
from car_interface.tools.doctor.cli import read_options, show
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding


def test_options_are_read_without_remappings_and_by_default_name_nothing_but_the_namespace(monkeypatch):
    monkeypatch.delenv("ROS_NAMESPACE", raising=False)
    assert vars(read_options([])) == {**dict.fromkeys(("port", "bus", "address", "namespace")), "probe": False}
    monkeypatch.setenv("ROS_NAMESPACE", "car1/")
    assert read_options([]).namespace == "/car1"
    arguments = ["--port", "/dev/ttyACM0", "__name:=doctor", "--i2c", "7", "--address", "0x41", "--ns", "/a/b/",
                 "--probe"]
    assert vars(read_options(arguments)) == {
        "port": "/dev/ttyACM0", "bus": "7", "address": 0x41, "namespace": "/a/b", "probe": True}


@pytest.mark.parametrize("arguments, words", [
    (["--address", "0x80"], "accepted: 0x40 to 0x7f"), (["--what"], "--what")], ids=["out_of_range", "unknown"])
def test_option_that_cannot_be_ends_with_one_line_about_it(arguments, words, capsys):
    with pytest.raises(SystemExit) as end:
        read_options(arguments)
    assert end.value.code == 2 and words in capsys.readouterr().err


@pytest.mark.parametrize("levels, worst", [([], OK), ([OK, WARN, OK], WARN), ([BAD, WARN], BAD)])
def test_findings_are_shown_a_line_each_and_the_worst_is_the_exit_code(levels, worst, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert show(iter([Finding(level, "bus", "what", "do") for level in levels])) == worst
    assert len(sys.stdout.getvalue().splitlines()) == len(levels) + 1


@pytest.mark.parametrize("left", [True, False], ids=["imported", "still_being_imported"])
def test_reader_that_leaves_ends_it_as_a_failure_also_while_rospy_is_being_imported(left, monkeypatch):
    def show(findings):
        raise BrokenPipeError(32, "Broken pipe")

    calls, codes = [], []
    probes = types.SimpleNamespace(**({"leave": lambda: calls.append("leave")} if left else {}))
    monkeypatch.setitem(sys.modules, cli.TOPICS, probes)
    monkeypatch.setattr(cli, "show", show)
    monkeypatch.setattr(cli.os, "_exit", codes.append)
    monkeypatch.setattr(sys, "argv", ["doctor"])
    cli.main()
    assert (codes, calls) == ([BAD], ["leave"] if left else [])
