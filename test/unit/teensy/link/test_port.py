"""The serial port, on real pseudo-terminals: opening, reading, writing, losing it, and saying what's wrong with it."""

import errno
import grp
import io
import os
import pwd
import select
import subprocess
import termios
import time
import tty

import pytest

serial = pytest.importorskip("serial")

from car_interface.common.devices import header_of  # noqa: E402
from car_interface.common.errors import DeviceError  # noqa: E402
from car_interface.teensy.link import port  # noqa: E402
from car_interface.teensy.link.health import ABSENT, BUSY, FAILING, NO_PERMISSION, NO_PORT  # noqa: E402
from car_interface.teensy.link.port import SerialLink  # noqa: E402


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


@pytest.mark.parametrize("use", [lambda link: link.fileno(), lambda link: link.read(), lambda link: link.write(b"x")])
def test_link_that_is_closed_has_let_go_of_the_port_and_says_so_to_whoever_uses_it(terminal, link, use):
    descriptor = link.fileno()
    link.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    for closed in (link, SerialLink(terminal.path, 115200)):
        with pytest.raises(DeviceError, match=f"^Teensy on {terminal.path}: the port is not open. It is opened again"):
            use(closed)
        assert not closed.is_open


def test_every_byte_value_goes_through_unchanged_both_ways_and_one_alone_is_told_of(link, terminal):
    every = bytes(range(256))
    link.write(every)
    wait_for(terminal.far_end)
    assert os.read(terminal.far_end, 1000) == every
    for data in (b"\x7e", every):
        os.write(terminal.far_end, data)
        wait_for(link.fileno())
        assert (link.read(), link.read()) == (data, b"")


def refusal(path, baud=115200):
    link = SerialLink(path, baud)
    with pytest.raises(DeviceError, match=r"^Teensy on ") as caught:
        link.open()
    assert not link.is_open
    assert caught.value.what == f"Teensy on {path}"
    assert isinstance(caught.value.__cause__, (OSError, ValueError, termios.error))
    return caught.value


@pytest.mark.parametrize("name, cause", [
    ("", "this is a directory, not a serial port"), ("ttyACM7", "there is no such port"),
    ("dangling", "there is no such port"), ("file", "this is not a serial port"),
    (os.devnull, "this is not a serial port"),
])
def test_path_that_is_no_port_is_refused_and_left_alone(tmp_path, name, cause):
    (tmp_path / "dangling").symlink_to(tmp_path / "gone")
    (tmp_path / "file").write_text("not a port")
    error = refusal(os.path.join(str(tmp_path), name))
    assert error.cause == cause and "ls /dev/serial/by-id" in error.remedy
    assert (tmp_path / "file").read_text() == "not a port"


@pytest.mark.parametrize("number, state, cause, remedy", [
    (errno.EBUSY, BUSY, "another program has it open", "fuser -v "),
    (errno.EAGAIN, BUSY, "another program has it open", "fuser -v "),
    (errno.ENOENT, ABSENT, "there is no such port", "ls /dev/serial/by-id"),
    (errno.ENOTTY, NO_PORT, "this is not a serial port", "ls /dev/serial/by-id"),
    (errno.EIO, FAILING, "it can't be opened (could not open port)", "Check ~port and ~baud"),
], ids=["device_busy", "locked", "gone_in_between", "not_a_terminal", "anything_else"])
def test_port_that_the_system_refuses_is_explained_by_the_error_s_number(terminal, monkeypatch, number, state, cause,
                                                                         remedy):
    refuse_with(number, monkeypatch)
    error = refusal(terminal.path)
    assert (error.state, error.cause.replace(f"[Errno {number}] ", "")) == (state, cause)
    assert remedy in error.remedy


@pytest.mark.parametrize("path, teensys, model, remedy", [
    ("/dev/ttyX", [], "", "Plug the Teensy in and see what it is called: ls /dev/serial/by-id /dev/ttyA*"),
    ("/dev/ttyX", ["/dev/serial/by-id/usb-Teensy"], "", "A Teensy is plugged in: port:=/dev/serial/by-id/usb-Teensy"),
    ("/dev/teensy_sensor_hub", ["/dev/serial/by-id/usb-Teensy"], "", "comes by rosrun car_interface setup_hardware"),
    ("/dev/teensy_sensor_hub", [], "", "Plug the Teensy in. It has this name on USB alone, after rosrun car_i"),
    ("/dev/ttyAMA0", [], "Raspberry Pi 5 Model B Rev 1.0", "/dev/ttyAMA0: pins 8 and 10 need dtoverlay=uart0-pi5"),
], ids=["anything", "on_usb", "rule_is_missing", "neither", "pins_of_the_header"])
def test_port_that_is_absent_has_the_remedy_of_what_is_there(monkeypatch, path, teensys, model, remedy):
    refuse_with(errno.ENOENT, monkeypatch)
    monkeypatch.setattr(port.glob, "glob", lambda pattern: teensys)
    monkeypatch.setattr(port, "read_header", lambda: header_of(model))
    error = refusal(path)
    assert error.state == ABSENT and remedy in error.remedy


def refuse_with(number, monkeypatch):
    """Root, as in a container, may open anything."""
    def refuse(*args, **kwargs):
        raise serial.SerialException(number, "could not open port")
    monkeypatch.setattr(serial, "Serial", refuse)


def stat_of(group, mode=0o20660):
    return lambda path: os.stat_result((mode, 3, 26, 1, 0, group, 0, 0, 0, 0))


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
def test_port_without_permission_names_the_group(terminal, monkeypatch, number):
    refuse_with(number, monkeypatch)
    monkeypatch.setattr(os, "stat", stat_of(20))
    monkeypatch.setattr(os, "getgroups", list)
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group(("dialout", "x", number, [])))
    error, user = refusal(terminal.path), pwd.getpwuid(os.geteuid()).pw_name
    assert (error.state, error.cause) == (
        NO_PERMISSION, f"no permission to open it: {user} is not in its group, dialout")
    assert error.remedy == "rosrun car_interface setup_hardware, then log in anew"


def test_port_that_a_log_in_console_has_is_told_as_such_and_its_group_is_not_to_be_joined(monkeypatch):
    refuse_with(errno.EACCES, monkeypatch)
    monkeypatch.setattr(os, "stat", stat_of(5, 0o20620))
    monkeypatch.setattr(grp, "getgrgid", lambda number: grp.struct_group(("tty", "x", number, [])))
    error = refusal("/dev/ttyAMA7")
    assert (error.state, error.cause) == (NO_PERMISSION, "no permission to open it: a log-in console has it")
    assert error.remedy.startswith("sudo systemctl disable --now serial-getty@ttyAMA7 (on a Jetson: nvgetty), ")
    assert "console= out of the kernel's command line, and reboot" in error.remedy and "usermod" not in error.remedy


@pytest.fixture
def lock_port(terminal):
    """Have another program lock the port; it ends with its input."""
    started = []

    def lock():
        started.append(subprocess.Popen(["flock", "-o", terminal.path, "sh", "-c", "echo locked; cat"],
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        assert started[-1].stdout.readline() == b"locked\n"
        return started[-1]
    yield lock
    for process in started:
        if process.poll() is None:
            process.communicate()


def test_port_busy_names_the_process_that_has_locked_it_or_has_it_open(terminal, lock_port, monkeypatch):
    process = lock_port()
    with monkeypatch.context() as patch:
        patch.setattr("car_interface.teensy.link.port._lock_owners", lambda status: [])  # not every lock is in /proc
        assert refusal(terminal.path).cause.endswith(f": flock (process {process.pid})")
    error = refusal(terminal.path)
    assert error.state == BUSY
    assert error.cause == f"another program has it open: flock (process {process.pid})"
    assert error.remedy == f"See which one, and end it: fuser -v {terminal.path}"
    process.communicate()
    os.write(terminal.far_end, b"old")
    link = SerialLink(terminal.path, 115200)
    link.open()
    assert link.read() == b""  # what arrived before is dropped
    link.close()


def test_port_busy_by_what_proc_does_not_tell_is_still_explained_and_for_modem_manager_with_the_cure(
        terminal, lock_port, monkeypatch):
    lock_port()
    with monkeypatch.context() as patch:
        patch.setattr("car_interface.teensy.link.port.process_name", lambda pid: "ModemManager")
        assert "rosrun car_interface setup_hardware" in refusal(terminal.path).remedy

    def deny(*args, **kwargs):
        raise PermissionError(errno.EACCES, "denied")
    monkeypatch.setattr("builtins.open", deny)
    error = refusal(terminal.path)
    assert (error.state, error.cause) == (BUSY, "another program has it open")


def test_locks_of_processes_that_proc_does_not_number_have_no_owner(terminal, monkeypatch):
    """Those outside of a container are 0 in it, and those of open file descriptions -1."""
    status = os.stat(terminal.path)
    inode = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    text = "".join(f"{line}: FLOCK  ADVISORY  WRITE {pid} {inode} 0 EOF\n" for line, pid in enumerate((0, -1, 1, 7)))
    monkeypatch.setattr(port, "open", lambda *_, **__: io.StringIO(text), raising=False)
    assert port._lock_owners(status) == [1, 7]


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
    assert error.cause.startswith("it can't be opened (") and error.remedy == "Check ~port and ~baud"


@pytest.mark.parametrize("use", [lambda link: link.read(), lambda link: link.write(b"\x7e")], ids=["read", "write"])
def test_port_unplugged_is_noticed_and_closed(link, terminal, use):
    terminal.unplug()
    wait_for(link.fileno())
    with pytest.raises(DeviceError, match=r"the port was lost \(.*\)\. Check its cable and power; it is opened again"):
        use(link)
    assert not link.is_open


@pytest.mark.parametrize("read, words", [
    (lambda: b"", "the line hung up"), (lambda: os.close(-1), ".*Bad file descriptor"),
], ids=["end_as_of_a_usb_port_that_was_pulled_out", "failure"])
def test_port_that_fails_to_read_is_closed_with_the_reason(link, monkeypatch, read, words):
    monkeypatch.setattr(os, "read", lambda descriptor, size: read())
    with pytest.raises(DeviceError, match=rf"the port was lost \({words}\)"):
        link.read()
    assert not link.is_open


def test_port_that_cannot_even_be_closed_any_more_counts_as_closed(link, monkeypatch):
    def fail():
        raise OSError(5, "Input/output error")
    with monkeypatch.context() as patch:
        patch.setattr(link._serial, "close", fail)
        link.close()
    assert not link.is_open


def test_port_that_takes_nothing_is_given_up_without_blocking_or_spinning_and_opens_anew(link):
    cpu_s = time.process_time()
    with pytest.raises(DeviceError, match=r"the port was lost \(.*[Tt]imeout"):
        link.write(bytes(1_000_000))
    assert not link.is_open
    assert time.process_time() - cpu_s < 0.1
    link.open()
    link.write(bytes(60))
    assert link.is_open
