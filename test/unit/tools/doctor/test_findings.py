"""How findings look, and what they add up to."""
import pytest

from car_interface.tools.doctor.findings import BAD, OK, WARN, Finding, render, summarise, worst

GOOD = Finding(OK, "bus", "/dev/i2c-1")
POOR = Finding(BAD, "port", "/dev/ttyAMA0: there is no such port", "Plug the Teensy in: ls /dev/serial/by-id")
SO_SO = Finding(WARN, "clock", "not synchronised", "sudo timedatectl set-ntp true")


@pytest.mark.parametrize("findings, level, words", [
    ([GOOD, GOOD], 0, "2 ok: nothing to do"),
    ([GOOD, SO_SO], 1, "1 warn, 1 ok: nothing that is bad; read the warnings"),
    ([SO_SO, POOR, GOOD, POOR], 2, "2 bad, 1 warn, 1 ok: begin with the first that is bad"),
    ([], 0, "nothing was looked at"),
], ids=["all_ok", "a_warning", "something_bad", "nothing"])
def test_sum_and_exit_code_are_those_of_the_worst(findings, level, words):
    assert worst(findings) == level
    assert summarise(findings) == words


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


def test_a_command_is_never_broken_at_a_hyphen():
    for length in range(40, 62):  # wherever the line ends, it isn't in the middle of the command
        assert "apt-get" in render(Finding(BAD, "port", "x" * length + " apt-get"), 80)
