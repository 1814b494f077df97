"""Prints the packages that a distribution has for what package.xml names, and for what else the tests need.

    packages.py debian|noetic apt|pip|python3.8

- ``apt``: packages of Debian 12 with its own ROS 1, or of Ubuntu 20.04 with ROS Noetic.
- ``pip``: packages of which the distribution has none.
- ``python3.8``: what a Python without any of the distribution's packages needs, by pip.
"""
from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

PACKAGE_XML = Path(__file__).resolve().parents[1] / "package.xml"
# ROS packages that the commands and the tests call, and that package.xml need not name.
ROS_TOOLS = ("rosbash", "rosmsg", "rosout", "rosparam", "rosservice", "rostopic")
TOOLS = ("cmake", "g++", "iproute2", "make", "python3-pytest-xdist", "python3-venv")
DEBIAN_TOOLS = ("libfaketime",)
NOT_NEEDED = ("rviz",)  # large; `./dev demo --display` installs it
# Debian's packages of a ROS key, where they are not python3-KEY, or for messages also libKEY-dev.
DEBIAN = {
    "catkin": ("catkin", "python3-catkin"),
    "diagnostic_msgs": ("python3-diagnostic-msgs",),
    "dynamic_reconfigure": ("libdynamic-reconfigure-config-init-mutex-dev", "python3-dynamic-reconfigure"),
    "message_generation": ("ros-message-generation",),
    "message_runtime": ("ros-message-runtime",),
    "rosbash": ("rosbash",),
    "rosgraph_msgs": ("python3-rosgraph-msgs",),
    "rosout": ("rosout",),
    "rostest": ("librostest-dev", "python3-rostest"),
}
BOUNDS = (("version_gte", ">="), ("version_lte", "<="))
# Where it is not KEY without python3- and -pip.
PIP = {"python3-pil": "Pillow", "python3-serial": "pyserial", "python3-yaml": "PyYAML"}


def keys(distribution: str) -> dict[str, str]:
    """Return the keys in package.xml whose condition holds, in order, with their version's bounds as pip writes them.

    Raises:
        ValueError: a condition is not `$ROS_DISTRO ==` or `!= NAME`.
    """
    found = {}
    for tag in ElementTree.parse(str(PACKAGE_XML)).getroot():
        key = (tag.text or "").strip()
        if tag.tag.endswith("depend") and key not in NOT_NEEDED and holds(tag.get("condition"), distribution):
            bounds = [sign + tag.get(name) for name, sign in BOUNDS if tag.get(name)]
            found[key] = ",".join(bounds) or found.get(key, "")
    return found


def holds(condition: str | None, distribution: str) -> bool:
    """Return whether the condition of a dependency holds for a distribution."""
    if condition is None:
        return True
    variable, operator, name = condition.split()
    if variable != "$ROS_DISTRO" or operator not in ("==", "!="):
        raise ValueError(f"package.xml: this condition is not understood: {condition}")
    return (name == distribution) == (operator == "==")


def apt_names(key: str, distribution: str) -> tuple[str, ...]:
    """Return the distribution's packages of a key that is not from pip."""
    if "-" in key or key in TOOLS:
        return (key,)
    name = key.replace("_", "-")
    if distribution == "noetic":
        return (f"ros-noetic-{name}",)
    if key in DEBIAN:
        return DEBIAN[key]
    if key.endswith(("_msgs", "_srvs")):
        return (f"lib{name}-dev", f"python3-{name}")
    return (f"python3-{name}",)


def packages(distribution: str, kind: str) -> list[str]:
    wanted = keys(distribution)
    if kind == "apt":
        found = [name for key in (*wanted, *ROS_TOOLS, *TOOLS) if not key.endswith("-pip")  # REP 111
                 for name in apt_names(key, distribution)]
        found += DEBIAN_TOOLS if distribution == "debian" else ()
    else:
        named = [key for key in wanted if key.endswith("-pip")] if kind == "pip" else [
            key for key in (*wanted, *TOOLS) if key.startswith("python3-") and key != "python3-venv"]
        found = [PIP.get(key, key[len("python3-"):].replace("-pip", "")) + wanted.get(key, "") for key in named]
    return sorted(set(found))


if __name__ == "__main__":
    print(*packages(*sys.argv[1:]))
