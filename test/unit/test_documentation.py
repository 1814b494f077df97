"""README and docs: links, paths, parameters and commands that they name exist."""
from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from node_reference import TABLE, written

from car_interface.ros.start import CONFIGS

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
INSTALL = ROOT / "docs/install.md"
NODE_REFERENCE = ROOT / "docs/nodes.md"
FOLDERS = ("cfg", "config", "demo", "docs", "launch", "msg", "scripts", "src", "srv", "test", "udev")
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
# Folders of a repository path, or a launch file, in a word of the text.
PATH = re.compile(rf"(?<![\w./~$:-])((?:{'|'.join(FOLDERS)})/[\w./-]*\w|\w+\.launch)(?![\w/])")


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def anchors(path: Path) -> set[str]:
    """Returns the anchors that GitHub makes of a page's headings."""
    headings = re.findall(r"^#+ +(.+?) *$", re.sub(r"^```.*?^```", "", text_of(path), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_paths_commands_and_measuring_programs_that_a_page_names_exist(page):
    text, broken = text_of(page), []
    for link in LINK.findall(text):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not re.match(r"https?://", link) and (not target.exists() or (anchor and anchor not in anchors(target))):
            broken.append(link)
    # `turn_arb/state` and the like are topics; only what begins with a folder of the repository is a path.
    broken += [path for path in PATH.findall(LINK.sub("", text))
               if not (ROOT / path).exists() and not (ROOT / "launch" / path).exists()]
    broken += [name for name in re.findall(r"python3 -m accuracy\.(\w+)", text)
               if not (ROOT / "test/accuracy" / f"{name}.py").exists()]
    broken += [name for name in re.findall(r"rosrun car_interface (\w+)", text)
               if not any((ROOT / folder / name).exists() for folder in ("scripts", "demo")) and name != "COMMAND"]
    assert broken == []


def test_readme_links_every_page():
    linked = {link.partition("#")[0] for link in LINK.findall(text_of(README))}
    assert {name_of(page) for page in PAGES if page != README} - linked == set()


def test_install_page_lists_every_argument_of_car_launch():
    declared = {arg.get("name") for arg in ElementTree.parse(str(ROOT / "launch/car.launch")).getroot().findall("arg")}
    (arguments,) = re.findall(r"^## Launch\n.*?(?=^## )", text_of(INSTALL), re.S | re.M)
    assert declared - set(re.findall(r"`(\w+)`", arguments)) == set()


def test_install_page_and_recordings_name_the_debian_package_of_every_dependency():
    # Those of ROS's own tools come with ros-core; rosbags, which Debian doesn't package, by pip.
    other_names = {"message_runtime": "ros-message-runtime", "rviz": "rviz", "python3-rosbags-pip": "rosbags",
                   **dict.fromkeys(("rosbag", "roslaunch", "rosgraph", "roslib", "rospy", "python3-rospkg"),
                                   "ros-core")}
    package = ElementTree.parse(str(ROOT / "package.xml")).getroot()
    keys = [tag.text for tag in package.findall("exec_depend") if "== noetic" not in tag.get("condition", "")]
    debian = {key: other_names.get(key) or "python3-" + re.sub("^python3-", "", key).replace("_", "-") for key in keys}
    words = set(re.findall(r"[\w.-]+", text_of(INSTALL) + text_of(ROOT / "docs/recordings.md")))
    assert {key: name for key, name in debian.items() if name not in words} == {}


def test_node_reference_has_the_table_of_each_node_of_a_car_as_its_parameters_are_declared():
    text = text_of(NODE_REFERENCE)
    assert written(text) == text, "python3 test/node_reference.py"
    # The simulated car's are for tests: its --help lists them.
    assert {found[2] for found in TABLE.finditer(text)} == set(CONFIGS) - {"car_sim"}
