"""The serial port, on real pseudo-terminals: opening, reading, writing, losing it, and saying what's wrong with it."""
from __future__ import annotations

import errno
import os
import select
import termios
import time
import tty

import pytest

serial = pytest.importorskip("serial")

from car_interface.errors import DeviceError  # noqa: E402
from car_interface.teensy.link import SerialLink  # noqa: E402


class Terminal:
    """A pseudo-terminal: the far end of a serial line, and the path of its port."""

    def __init__(self):
        self.far_end, self._port = os.openpty()
        tty.setraw(self._port)
        self.path = os.ttyname(self._port)

    def unplug(self):
        for end in (self.far_end, self._port):
            if end is not None:
                os.close(end)
        self.far_end = self._port = None


@pytest.fixture
def terminal():
    terminal = Terminal()
    yield terminal
    terminal.unplug()


@pytest.fixture
def link(terminal):
    link = SerialLink(terminal.path, 115200)
    link.open()
    yield link
    link.close()


def wait_for(descriptor):
    assert select.select([descriptor], [], [], 2.0)[0], "nothing arrived within 2 s"


def test_link_opened_is_open_and_closed_is_not(link):
    assert link.is_open
    link.close()
    assert not link.is_open


def test_link_before_it_was_opened_is_not_open(terminal):
    assert not SerialLink(terminal.path, 115200).is_open


def test_link_closed_lets_go_of_the_port(link):
    descriptor = link.fileno()
    link.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)


def test_link_closed_twice_is_still_closed(link):
    link.close()
    link.close()
    assert not link.is_open


def test_read_returns_what_arrived_and_select_tells_when(link, terminal):
    os.write(terminal.far_end, b"\x7e\x00\x11\x13\x7e")
    wait_for(link.fileno())
    assert link.read() == b"\x7e\x00\x11\x13\x7e"


def test_read_when_nothing_arrived_is_empty_and_does_not_block(link):
    assert link.read() == b""


def test_single_byte_is_told_of_and_read(link, terminal):
    os.write(terminal.far_end, b"\x7e")
    wait_for(link.fileno())
    assert link.read() == b"\x7e"
    assert link.read() == b""


def test_read_of_much_is_bounded_and_goes_on(link, terminal):
    received = b""
    for _ in range(4):
        os.write(terminal.far_end, bytes(3000))
        wait_for(link.fileno())
        data = link.read()
        assert len(data) <= 4096
        received += data
    while select.select([link.fileno()], [], [], 0.1)[0]:
        received += link.read()
    assert received == bytes(12_000)


def test_every_byte_value_goes_through_unchanged_both_ways(link, terminal):
    every = bytes(range(256))
    link.write(every)
    wait_for(terminal.far_end)
    assert os.read(terminal.far_end, 1000) == every
    os.write(terminal.far_end, every)
    wait_for(link.fileno())
    assert link.read() == every


def test_open_drops_what_arrived_before(terminal):
    os.write(terminal.far_end, b"old")
    link = SerialLink(terminal.path, 115200)
    link.open()
    assert link.read() == b""
    link.close()


def test_second_opener_is_refused_while_the_first_has_it_and_not_after(link, terminal):
    other = SerialLink(terminal.path, 115200)
    with pytest.raises(DeviceError, match=r"another program has it open.*fuser -v " + terminal.path):
        other.open()
    assert not other.is_open
    os.write(terminal.far_end, b"still mine")
    wait_for(link.fileno())
    assert link.read() == b"still mine"
    link.close()
    other.open()
    assert other.is_open
    other.close()


def refusal(path, baud=115200):
    link = SerialLink(path, baud)
    with pytest.raises(DeviceError, match=r"^Teensy on ") as caught:
        link.open()
    assert not link.is_open
    assert caught.value.what == f"Teensy on {path}"
    assert isinstance(caught.value.__cause__, (OSError, ValueError, termios.error))
    return caught.value


def test_port_that_is_a_directory_is_refused(tmp_path):
    error = refusal(str(tmp_path))
    assert error.cause == "this is a directory, not a serial port"
    assert "ls /dev/serial/by-id" in error.cure


def test_port_that_does_not_exist_is_refused(tmp_path):
    error = refusal(str(tmp_path / "ttyACM7"))
    assert error.cause == "there is no such port"
    assert "ls /dev/serial/by-id" in error.cure


def test_port_that_is_a_dangling_link_is_refused(tmp_path):
    path = tmp_path / "teensy"
    path.symlink_to(tmp_path / "gone")
    assert refusal(str(path)).cause == "there is no such port"


def test_port_that_is_a_file_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_text("not a port")
    assert refusal(str(path)).cause == "this is not a serial port"
    assert path.read_text() == "not a port"


def test_port_that_is_dev_null_is_refused():
    error = refusal(os.devnull)
    assert error.cause == "this is not a serial port"
    assert "ls /dev/serial/by-id" in error.cure


@pytest.mark.parametrize("number, cause, cure", [
    pytest.param(errno.EACCES, "no permission to open it", "usermod -aG dialout", id="permission_denied"),
    pytest.param(errno.EPERM, "no permission to open it", "usermod -aG dialout", id="operation_not_permitted"),
    pytest.param(errno.EBUSY, "another program has it open", "fuser -v ", id="device_busy"),
    pytest.param(errno.EAGAIN, "another program has it open", "fuser -v ", id="locked"),
    pytest.param(errno.ENOENT, "there is no such port", "ls /dev/serial/by-id", id="gone_in_between"),
    pytest.param(errno.ENOTTY, "this is not a serial port", "ls /dev/serial/by-id", id="not_a_terminal"),
    pytest.param(errno.EIO, "it can't be opened (could not open port)", "Check ~port and ~baud", id="anything_else"),
])
def test_port_that_the_system_refuses_is_explained_by_the_error_s_number(terminal, monkeypatch, number, cause, cure):
    def refuse(*args, **kwargs):
        raise serial.SerialException(number, "could not open port")
    monkeypatch.setattr(serial, "Serial", refuse)  # root, as in a container, may open anything
    error = refusal(terminal.path)
    assert error.cause.replace(f"[Errno {number}] ", "") == cause
    assert cure in error.cure


def test_port_that_fails_while_it_is_set_up_is_left_to_others(terminal, monkeypatch):
    set_attributes = termios.tcsetattr

    def fail_at_last(descriptor, when, attributes):
        if attributes[6][termios.VMIN]:
            raise termios.error(errno.EIO, "Input/output error")
        set_attributes(descriptor, when, attributes)
    with monkeypatch.context() as patch:
        patch.setattr(termios, "tcsetattr", fail_at_last)
        error = refusal(terminal.path)
    assert "Input/output error" in error.cause
    link = SerialLink(terminal.path, 115200)
    link.open()
    link.close()


def test_baud_that_no_port_takes_is_refused_with_what_pyserial_says(terminal):
    error = refusal(terminal.path, baud=-1)
    assert error.cause.startswith("it can't be opened (")
    assert error.cure == "Check ~port and ~baud"


def test_port_unplugged_is_noticed_by_read_and_closed(link, terminal):
    terminal.unplug()
    wait_for(link.fileno())
    with pytest.raises(DeviceError, match=r"the port was lost \(.*\)\. Check its cable and power; it is opened again"):
        link.read()
    assert not link.is_open


def test_port_unplugged_is_noticed_by_write_and_closed(link, terminal):
    terminal.unplug()
    with pytest.raises(DeviceError, match=r"the port was lost \("):
        link.write(b"\x7e")
    assert not link.is_open


def test_port_hung_up_reads_as_its_end_and_is_closed(link, monkeypatch):
    monkeypatch.setattr(os, "read", lambda descriptor, size: b"")  # as a USB port does that was pulled out
    with pytest.raises(DeviceError, match=r"the port was lost \(the line hung up\)"):
        link.read()
    assert not link.is_open


def test_port_that_fails_to_read_is_closed_with_the_system_s_word_for_it(link, monkeypatch):
    def fail(descriptor, size):
        raise OSError(5, "Input/output error")
    monkeypatch.setattr(os, "read", fail)
    with pytest.raises(DeviceError, match=r"the port was lost \(.*Input/output error\)"):
        link.read()
    assert not link.is_open


def test_port_that_cannot_even_be_closed_any_more_counts_as_closed(link, monkeypatch):
    def fail():
        raise OSError(5, "Input/output error")
    with monkeypatch.context() as patch:
        patch.setattr(link._serial, "close", fail)
        link.close()
    assert not link.is_open


def test_port_that_takes_nothing_is_given_up_instead_of_blocking(link):
    before_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"the port was lost \(.*[Tt]imeout"):
        link.write(bytes(1_000_000))
    assert not link.is_open
    assert time.monotonic() - before_s < 1.5


def test_port_plugged_in_again_under_its_name_is_opened_again(tmp_path):
    path = tmp_path / "teensy"
    first, second = Terminal(), Terminal()
    path.symlink_to(first.path)
    link = SerialLink(str(path), 115200)
    link.open()
    first.unplug()
    with pytest.raises(DeviceError, match="the port was lost"):
        link.read()
    path.unlink()
    path.symlink_to(second.path)
    link.open()
    os.write(second.far_end, b"back")
    wait_for(link.fileno())
    assert link.read() == b"back"
    link.close()
    second.unplug()
