"""test/set_up.py and ./dev: what is installed on which ROS, when nothing is, and what is refused in one line."""
import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import on_virtual_car
import pytest
import set_up

ROOT = Path(__file__).resolve().parents[2]


def write(path: Path, text: str = "", mode: int = 0o644) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


# --- which ROS, and its packages ---

@pytest.mark.parametrize("installed, expected", [
    (["noetic"], "noetic"), (["one"], "one"), (["humble", "one"], "one"), (["noetic", "one"], "one"),
    ([], "Debian"), (["humble"], "Debian"),
], ids=["noetic", "one", "beside_ros_2", "the_newer_of_two", "none", "ros_2_alone"])
def test_ros_is_what_is_installed_and_otherwise_debian_s(tmp_path, installed, expected):
    for name in installed:
        write(tmp_path / name / "setup.bash")
    assert set_up.distribution(tmp_path) == expected


@pytest.mark.parametrize("distribution, wanted, unwanted", [
    ("Debian", ["python3-rospy", "libsensor-msgs-dev", "ros-environment", "python3-smbus2"], ["python3-rviz", "rviz"]),
    ("one", ["ros-one-rospy", "ros-one-diagnostic-updater", "ros-one-rosbash", "python3-smbus2", "cmake"],
     ["ros-environment", "python3-rospy"]),
    ("noetic", ["ros-noetic-sensor-msgs", "python3-serial"], ["python3-smbus2", "python3-rosbags"]),
])
def test_apt_s_packages_are_named_as_the_distribution_names_them(tmp_path, distribution, wanted, unwanted):
    names = set_up.apt_packages(distribution, tmp_path)
    assert set(wanted) - set(names) == set() == set(unwanted) & set(names)


def test_package_that_a_prefix_has_by_whatever_way_is_not_asked_of_apt(tmp_path):
    write(tmp_path / "one/share/rospy/package.xml")
    names = set_up.apt_packages("one", tmp_path)
    assert "ros-one-rospy" not in names and "ros-one-rosbag" in names


def test_pip_adds_what_the_distribution_lacks_and_gives_a_python_of_its_own_everything():
    rosbags = "rosbags>=0.9.23,<=0.11.9"
    added = {name: set_up.pip_packages(name, is_alone=False) for name in ("Debian", "one", "noetic")}
    assert added == {"Debian": [rosbags], "one": [rosbags], "noetic": [rosbags, "smbus2"]}
    assert {"PyYAML", "Pillow", "numpy", "pytest-xdist", "smbus2"} <= set(set_up.pip_packages("Debian", is_alone=True))


def test_condition_in_package_xml_that_is_not_understood_is_refused():
    with pytest.raises(ValueError, match=r"not understood: .ROS_PYTHON_VERSION == 2"):
        set_up.holds("$ROS_PYTHON_VERSION == 2", "one")


# --- what can't be installed: cause and remedy in one line ---

@pytest.mark.parametrize("update, install, expected", [
    ("W: Failed to fetch http://deb.debian.org/  Temporary failure resolving", "E: Unable to locate package cmake",
     "connect this computer to the network"),
    ("", "E: Unable to locate package python3-rospy\nE: Package 'catkin' has no installation candidate",
     "no package catkin, python3-rospy for this system; ROS 1 is in"),
    ("", "E: dpkg was interrupted, you must manually run 'dpkg --configure -a' to correct the problem.",
     "run 'sudo dpkg --configure -a', and try again"),
    ("", "sudo: a terminal is required to read the password", "to read the password): have"),
    ("", "driver is not in the sudoers file.", "have an administrator of this computer run ./dev setup"),
    ("", "E: You don't have enough free space", "could not install the packages"),
], ids=["no_network", "a_system_without_ros_1", "interrupted_before", "nobody_at_the_terminal", "not_a_sudoer",
        "anything_else"])
def test_failure_of_apt_names_its_cause(update, install, expected):
    line = set_up.apt_failure(update, install)
    assert expected in line and "\n" not in line


@pytest.mark.parametrize("log, expected", [
    ("Retrying after NewConnectionError\nERROR: No matching distribution found",
     "connect this computer to the network, and try again"),
    ("OSError: [Errno 28] No space left on device", "pip could not install what lint.txt names"),
], ids=["no_network", "anything_else"])
def test_failure_of_pip_names_its_cause(log, expected):
    line = set_up.pip_failure(log, "lint.txt")
    assert expected in line and "\n" not in line


@pytest.mark.parametrize("programs, expected", [
    (["apt-get"], "missing packages, and neither root nor sudo to install them: apt-get install no-such-package"),
    (["sudo"], "there is no apt here to install no-such-package; ROS 1 is in"),
], ids=["no_root", "no_apt"])
def test_missing_package_that_can_t_be_installed_is_named(tmp_path, monkeypatch, capsys, programs, expected):
    for name in programs:
        write(tmp_path / name, "#!/bin/sh\n", 0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(SystemExit):
        set_up.SetUp(tmp_path).apt("no-such-package")
    assert expected in capsys.readouterr().err


def dev_env(**environment: str) -> subprocess.CompletedProcess:
    return subprocess.run([str(ROOT / "dev"), "env"], env={"PATH": "/usr/bin:/bin", **environment},
                          capture_output=True, text=True, check=False)


@pytest.mark.parametrize("environment, expected", [
    ({}, "HOME is not set: set CAR_INTERFACE_WORKSPACE to a directory to build in"),
    ({"HOME": "/proc/nobody"}, "cannot write to /proc/nobody/"),
    ({"CAR_INTERFACE_WORKSPACE": "/tmp/my car"}, "/tmp/my car has white space in its name"),
    ({"CAR_INTERFACE_WORKSPACE": str(ROOT / "build")}, "lies inside the checkout"),
], ids=["no_home", "a_home_that_is_not_there", "white_space", "inside_the_checkout"])
def test_dev_refuses_a_workspace_that_can_t_be_in_one_line(environment, expected):
    done = dev_env(**environment)
    assert (done.returncode, done.stdout) == (1, "") and expected in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.skipif(set_up.distribution() != "Debian", reason="a ROS in /opt/ros comes before ROS 2's messages")
def test_dev_env_refuses_a_terminal_that_has_sourced_ros_2(tmp_path):
    done = dev_env(CAR_INTERFACE_WORKSPACE=str(tmp_path), ROS_VERSION="2")
    assert (done.returncode, done.stdout) == (1, "") and "sourced ROS 2" in done.stderr and "new one" in done.stderr


def test_apt_writes_into_the_system_what_others_can_read_whatever_the_umask(tmp_path, monkeypatch):
    write(tmp_path / "apt-get", "#!/bin/sh\numask\n", 0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    before = os.umask(0o077)
    try:
        printed = subprocess.check_output([*set_up.APT_GET, "install"], text=True)
    finally:
        os.umask(before)
    assert printed == "0022\n"


# --- pip's packages ---

def test_each_requirement_is_pinned_with_hashes_and_no_index_is_named():
    assert {path.stem for path in set_up.REQUIREMENTS.iterdir()} == set(set_up.pins())
    for name, (wanted, _, left_out) in set_up.pins().items():
        text = (set_up.REQUIREMENTS / f"{name}.txt").read_text(encoding="utf-8")
        blocks = re.split(r"\n(?=\S)", text.strip())
        assert all(re.match(r"[\w.-]+==[\w.]+( ;.*)? \\\n +--hash=sha256:[0-9a-f]{64}", block) for block in blocks)
        assert not re.search(r"https?:|file:|index", text)
        pinned = {re.split("[= ]", block)[0].replace("-", "_") for block in blocks}
        assert {each.lower().replace("-", "_") for each in set_up.names_of(wanted)} <= pinned
        assert not {each.lower().replace("-", "_") for each in left_out} & pinned


def wheel(folder: Path) -> Path:
    """Return a package that pip can install."""
    path = folder / "tiny-1.0-py3-none-any.whl"
    with zipfile.ZipFile(str(path), "w") as archive:
        archive.writestr("tiny.py", "")
        archive.writestr("tiny-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n")
        archive.writestr("tiny-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        archive.writestr("tiny-1.0.dist-info/RECORD", "")
    return path


def test_file_with_another_hash_is_refused_in_one_line_and_nothing_is_installed(tmp_path, monkeypatch, capsys):
    digest = hashlib.sha256(wheel(tmp_path).read_bytes()).hexdigest()
    monkeypatch.setattr(set_up, "ROOT", tmp_path)
    monkeypatch.setattr(set_up, "REQUIREMENTS", tmp_path)
    for name, value in (("CONFIG_FILE", os.devnull), ("NO_INDEX", "1"), ("FIND_LINKS", str(tmp_path))):
        monkeypatch.setenv(f"PIP_{name}", value)
    (tmp_path / "log").mkdir()
    write(tmp_path / "lint.txt", f"tiny==1.0 --hash=sha256:{digest[::-1]}\n")
    with pytest.raises(SystemExit):
        set_up.SetUp(tmp_path)._venv("lint", sys.executable, "lint")
    begun, refused = capsys.readouterr().err.splitlines()
    assert begun == "Installing with pip what lint.txt names"
    assert "another file of tiny==1.0 than the one that test/requirements/lint.txt names" in refused
    assert not list(tmp_path.glob("venv-lint/lib/*/site-packages/tiny.py"))
    write(tmp_path / "lint.txt", f"tiny==1.0 --hash=sha256:{digest}\n")
    run = set_up.SetUp._run  # the environment is there already
    monkeypatch.setattr(set_up.SetUp, "_run", lambda self, name, *more, **named:
                        name == "venv" or run(self, name, *more, **named))
    assert list(set_up.SetUp(tmp_path)._venv("lint", sys.executable, "lint").glob("lib/*/site-packages/tiny.py"))


# --- when nothing is to be done ---

@pytest.fixture
def built(tmp_path):
    """A workspace as a build leaves it."""
    write(tmp_path / "dev/venv-system/bin/python")
    write(tmp_path / "devel/built_of", set_up.build_inputs(set_up.distribution()))
    return tmp_path


def test_workspace_that_is_up_to_date_is_taken_at_once_though_another_one_builds(built, monkeypatch, capsys):
    monkeypatch.setattr(set_up, "subprocess", None)  # nothing is started
    with open(str(built / "dev/build.lock"), "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        set_up.SetUp(built / "dev").build()
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("activated, begins", [({}, "/usr/bin:"), ({"VIRTUAL_ENV": "/mine"}, "/mine/bin:")],
                         ids=["conda_or_pyenv_first", "a_virtual_environment"])
def test_env_leaves_a_virtual_environment_and_the_shell_s_flags_as_they_were(built, activated, begins):
    write(built / "devel/setup.bash", "false\necho $not_set\nexport FOUND=devel")
    printed = dev_env(CAR_INTERFACE_WORKSPACE=str(built))
    assert (printed.returncode, printed.stderr) == (0, "")
    show = 'eval "$1"; echo "$PATH ${PYTHONPATH:-none} $FOUND $-"'
    path = "/mine/bin:/opt/conda/bin:/usr/bin:/bin"
    path, python_path, found, flags = subprocess.check_output(
        ["/bin/bash", "-euc", show, "bash", printed.stdout], env={"PATH": path, **activated}, text=True).split()
    assert path.startswith(begins) and python_path == "none" and found == "devel" and {"e", "u"} <= set(flags)


@pytest.mark.parametrize("damage", [
    lambda folder: shutil.rmtree(str(folder / "devel")),
    lambda folder: shutil.rmtree(str(folder / "dev/venv-system")),
    lambda folder: write(folder / "devel/built_of", set_up.build_inputs("another")),
], ids=["devel_is_gone", "python_is_gone", "another_ros"])
def test_workspace_that_is_not_is_built(built, monkeypatch, damage):
    calls = []
    for name in ("ros", "_make"):
        monkeypatch.setattr(set_up.SetUp, name, lambda _, name=name: (built / "devel").mkdir(exist_ok=True)
                            or calls.append(name))
    damage(built)
    set_up.SetUp(built / "dev").build()
    set_up.SetUp(built / "dev").build()
    assert calls[:2] == ["ros", "_make"]
    assert len(calls) == (2 if (built / "dev/venv-system").exists() else 4)


@pytest.mark.parametrize("name", ["msg/Pong.msg", "srv/New.srv", "cfg/EscNeutral.cfg", "CMakeLists.txt", "package.xml"])
def test_build_depends_on_what_catkin_reads(tmp_path, monkeypatch, name):
    monkeypatch.setattr(set_up, "ROOT", tmp_path)
    before = set_up.build_inputs("one")
    write(tmp_path / name, "uint8 one")
    after = set_up.build_inputs("one")
    assert after != before and after.split("\n")[0] == before.split("\n")[0]


def test_pythons_are_pyenv_s_and_those_on_path_by_what_they_say(tmp_path, monkeypatch):
    for path, version in (("versions/3.8.18/bin/python", "3 8"), ("versions/3.10.1/bin/python", "3 11"),
                          ("bin/python3.12", "3 12")):
        write(tmp_path / path, f"#!/bin/sh\necho {version}\n", 0o755)
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert set_up.find_pythons([(3, 8), (3, 10), (3, 12), (3, 13)]) == {
        (3, 8): f"{tmp_path}/versions/3.8.18/bin/python", (3, 12): f"{tmp_path}/bin/python3.12"}


# --- what to do next ---

def test_demo_ends_with_steps_to_type_that_there_are():
    started = re.findall(r"ros(?:run|launch) car_interface (\S+)", on_virtual_car.NEXT_STEPS)
    assert started == ["demo.launch", "keyboard_drive", "practice.launch"]
    assert all((ROOT / "launch" / name).exists() or (ROOT / "scripts" / name).exists() for name in started)
    # It ends with a question whether to replace its table: not the package's own.
    assert "practice.launch config:=$HOME/practice_car\n" in on_virtual_car.NEXT_STEPS
    assert "## Practise without a car" in (ROOT / "docs/calibrate.md").read_text(encoding="utf-8")
