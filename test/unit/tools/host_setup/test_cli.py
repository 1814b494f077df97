"""setup_hardware: what it runs, what it shows, and how it ends."""
import fnmatch
import re
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common.devices import GROUPS, header_of
from car_interface.tools.host_setup import cli
from car_interface.tools.host_setup.cli import RULES_NAME, Computer, plan, remarks


def computer(user="ann", groups=("dialout", "input"), joined=(), has_udev=True, rules_are_new=False):
    return Computer(user, frozenset(groups), frozenset(joined), has_udev, rules_are_new)


@pytest.fixture
def run(monkeypatch, capsys):
    """Runs setup_hardware where some programs fail; its exit code, the programs that it ran, and what it printed."""
    def run(*failing, options=()):
        ran = []

        def execute(command, **_):
            ran.append(command[0])
            return subprocess.CompletedProcess(command, int(command[0] in failing))
        monkeypatch.setattr(subprocess, "run", execute)
        monkeypatch.setattr(cli, "read_computer", lambda user, rules: computer())
        monkeypatch.setattr(cli.os, "geteuid", lambda: 0)
        monkeypatch.setattr(cli, "package_file", lambda name: f"/share/{name}")
        monkeypatch.setattr(cli.pwd, "getpwnam", lambda name: None)
        monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "ann", *options])
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


def test_dry_run_shows_the_commands_and_runs_none(run):
    _, ran, said = run(options=["--dry-run"])
    assert ran == [] and "usermod --append --groups dialout,i2c,input ann" in said


def test_user_who_does_not_exist_is_told(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["setup_hardware", "--user", "nobody-of-that-name"])
    with pytest.raises(SystemExit, match="there is no user nobody-of-that-name"):
        cli.main()


RULES = Path(__file__).resolve().parents[4] / "udev" / RULES_NAME


def commands(of):
    return [" ".join(step.command) for step in plan(of, "/share/rules")]


def test_fresh_computer_gets_groups_rules_and_a_reload_in_this_order():
    assert commands(computer()) == [
        "groupadd --system i2c",
        "usermod --append --groups dialout,i2c,input ann",
        f"install -D --mode=644 /share/rules /etc/udev/rules.d/{RULES_NAME}",
        "udevadm control --reload-rules",
        "udevadm trigger --subsystem-match=tty --subsystem-match=i2c-dev",
    ]


@pytest.mark.parametrize("joined, rules_are_new, expected", [
    (GROUPS, True, []), (["dialout", "i2c"], True, ["usermod --append --groups input ann"]),
    (GROUPS, False, commands(computer())[2:]),
], ids=["nothing", "a_group", "rules"])
def test_only_what_is_missing_is_done_and_told(joined, rules_are_new, expected):
    done = computer(groups=GROUPS, joined=joined, rules_are_new=rules_are_new)
    assert commands(done) == expected and remarks(done) == []
    told = " ".join(step.remark for step in plan(done, "/share/rules"))
    assert ("log out and in again" in told) == (joined != GROUPS)


def test_without_udev_the_groups_are_made_and_root_is_added_to_none_and_the_rest_is_told():
    container = computer(has_udev=False)
    steps = plan(container, "/share/rules")
    assert [step.command[0] for step in steps] == ["groupadd", "usermod"]
    assert "There is no udevadm here" in " ".join(remarks(container))
    root = computer(user="root")
    assert "usermod" not in " ".join(commands(root))
    assert "--user NAME" in " ".join(remarks(root))


@pytest.mark.parametrize("model, has_bus, told", [
    ("Raspberry Pi 5 Model B Rev 1.0", True, ["pins 3 and 5 are /dev/i2c-1", "is on /dev/ttyAMA0: pins 8 and 10",
                                              "dtoverlay=uart0-pi5", "raspi-config, Interface Options"]),
    ("Raspberry Pi 4 Model B Rev 1.5", False, ["/dev/i2c-1, which is missing. Switch I2C on: sudo raspi-config nonint",
                                               "pins 8 and 10 is on /dev/serial0. If a log-in"]),
    ("NVIDIA Jetson Orin Nano Developer Kit", True, ["pins 3 and 5 are /dev/i2c-7", "one of /dev/ttyTHS*", "nvgetty"]),
    ("Some PC", False, []),
], ids=["pi_5", "pi_4_without_i2c", "jetson", "unknown"])
def test_pins_of_a_known_computer_are_told_with_what_they_need(model, has_bus, told):
    lines = remarks(computer(groups=GROUPS, joined=GROUPS, rules_are_new=True)._replace(
        header=header_of(model), has_bus=has_bus))
    assert [words for words in told if words not in " ".join(lines)] == [] and bool(lines) == bool(told)


# --- the rules ---

def rules():
    """Each rule as its comparisons and its assignments."""
    for line in RULES.read_text(encoding="ascii").splitlines():
        if line and not line.startswith("#"):
            pairs = re.findall(r'([\w{}]+)(==|\+=|=)"([^"]*)"(?:, |$)', line)
            assert ", ".join(f'{key}{sign}"{value}"' for key, sign, value in pairs) == line
            yield ({key: value for key, sign, value in pairs if sign == "=="},
                   {key: value for key, sign, value in pairs if sign != "=="})


def applied(subsystem, **attributes):
    assigned = {}
    for wanted, given in rules():
        facts = {"SUBSYSTEM": subsystem, **{f"ATTR{{{name}}}": value for name, value in attributes.items()},
                 **{f"ATTRS{{{name}}}": value for name, value in attributes.items()},
                 "ENV{ID_USB_INTERFACE_NUM}": attributes.get("interface"), "ENV{DEVTYPE}": "usb_device"}
        if all(facts.get(key) is not None and fnmatch.fnmatchcase(facts[key], value) for key, value in wanted.items()):
            assigned.update(given)
    return assigned


TEENSY = {"GROUP": "dialout", "MODE": "0660", "SYMLINK": "teensy_sensor_hub", "ENV{ID_MM_PORT_IGNORE}": "1",
          "ENV{ID_MM_DEVICE_IGNORE}": "1"}


@pytest.mark.parametrize(("subsystem", "vendor", "product", "given"), [
    *(("tty", "16c0", product, TEENSY) for product in ("0483", "0487", "0489", "048a", "048b", "048c")),
    ("usb", "16c0", "0483", {"ENV{ID_MM_DEVICE_IGNORE}": "1"}), ("i2c-dev", "", "", {"GROUP": "i2c", "MODE": "0660"}),
    ("tty", "16c0", "05dc", {}), ("tty", "2341", "0483", {}), ("usb", "2341", "0043", {}),
    ("block", "16c0", "0483", {}),
])
def test_every_teensy_with_a_serial_port_and_every_bus_gets_name_and_group_and_other_devices_nothing(
        subsystem, vendor, product, given):
    assert applied(subsystem, idVendor=vendor, idProduct=product, interface="00") == given


def test_second_port_does_not_take_the_name_and_rules_come_before_modem_manager_s():
    assert "SYMLINK" not in applied("tty", idVendor="16c0", idProduct="048b", interface="02")
    assert "60-serial.rules" < RULES_NAME < "77-mm-"
