"""What setup_hardware plans to do, and the udev rules that it installs."""
from __future__ import annotations

import fnmatch
import re
from pathlib import Path

import pytest

from car_interface.tools.host_setup.plan import GROUPS, RULES_NAME, Computer, plan, remarks

RULES = Path(__file__).resolve().parents[4] / "udev" / RULES_NAME


def computer(user="ann", groups=("dialout", "input"), joined=(), has_udev=True, rules_are_new=False):
    return Computer(user, frozenset(groups), frozenset(joined), has_udev, rules_are_new)


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
    assert commands(done) == expected and remarks(done, []) == []
    assert ("log out and in again" in " ".join(remarks(done, plan(done, "/share/rules")))) == (joined != GROUPS)


def test_without_udev_the_groups_are_made_and_the_rest_is_told():
    container = computer(has_udev=False)
    steps = plan(container, "/share/rules")
    assert [step.command[0] for step in steps] == ["groupadd", "usermod"]
    assert "There is no udevadm here" in " ".join(remarks(container, steps))


def test_root_is_added_to_no_group_and_told_so():
    root = computer(user="root")
    assert "usermod" not in " ".join(commands(root))
    assert "--user NAME" in " ".join(remarks(root, plan(root, "/share/rules")))


def test_only_what_udev_does_by_itself_later_may_fail():
    assert [step.command[0] for step in plan(computer(), "/share/rules") if step.may_fail] == ["udevadm", "udevadm"]
    assert all(step.otherwise for step in plan(computer(), "/share/rules") if step.may_fail)


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
    """What the rules assign to a device."""
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


def test_second_port_of_a_teensy_does_not_take_the_name():
    assert "SYMLINK" not in applied("tty", idVendor="16c0", idProduct="048b", interface="02")


def test_rules_come_after_the_interface_is_known_and_before_modem_manager():
    assert "60-serial.rules" < RULES_NAME < "77-mm-"
