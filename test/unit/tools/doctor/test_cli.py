"""The doctor's command line, and how its findings are shown."""
import io
import sys
import types

import pytest

from car_interface.tools.doctor import cli
from car_interface.tools.doctor.cli import read_options, show
from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, render


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


@pytest.mark.parametrize("levels, worst, words", [
    ([OK, OK], 0, "2 ok: nothing to do"),
    ([OK, WARN], 1, "1 warn, 1 ok: nothing that is bad; read the warnings"),
    ([WARN, BAD, OK, BAD], 2, "2 bad, 1 warn, 1 ok: begin with the first that is bad"),
], ids=["all_ok", "a_warning", "something_bad"])
def test_findings_are_shown_a_line_each_with_their_sum_and_the_worst_is_the_code(levels, worst, words, monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert show(iter([Finding(level, "bus", "what", "do") for level in levels])) == worst
    lines = sys.stdout.getvalue().splitlines()
    assert len(lines) == len(levels) + 1 and words in lines[-1]


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


GOOD = Finding(OK, "bus", "/dev/i2c-1")
POOR = Finding(BAD, "port", "/dev/ttyAMA0: there is no such port", "Plug the Teensy in: ls /dev/serial/by-id")


def test_finding_is_one_line_in_a_pipe_and_its_cure_has_lines_of_its_own_in_a_terminal():
    assert render(GOOD) == "ok    bus         /dev/i2c-1"
    assert render(POOR) == ("bad   port        /dev/ttyAMA0: there is no such port | remedy: Plug the Teensy in: "
                            "ls /dev/serial/by-id")
    assert render(Finding(OK, "bus", "two\nlines")).count("\n") == 0
    assert render(POOR, width=80) == ("bad   port        /dev/ttyAMA0: there is no such port\n"
                                      "                  remedy: Plug the Teensy in: ls /dev/serial/by-id")


def test_in_a_terminal_no_line_is_too_long_and_words_stay_whole():
    words = ["word" * (index % 5 + 1) for index in range(60)]
    text = render(Finding(BAD, "port", " ".join(words), " ".join(words)), 60)
    assert max(map(len, text.split("\n"))) <= 60
    assert text.split() == ["bad", "port", *words, "remedy:", *words]
    for length in range(40, 62):  # wherever the line ends, it isn't at a hyphen in the middle of a command
        assert "apt-get" in render(Finding(BAD, "port", "x" * length + " apt-get"), 80)
