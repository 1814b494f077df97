"""Installs what a command of ./dev needs: packages by apt, the rest by pip in virtual environments.

    set_up.py FOLDER ros                   what package.xml names and what the tests need
    set_up.py FOLDER build                 the same; then it builds the package in the workspace above FOLDER
    set_up.py FOLDER lint                  the linters
    set_up.py FOLDER pythons [--all]       the other Pythons that the tests run on: 3.8, and with --all the newest
    set_up.py FOLDER rviz                  rviz

It prints lines of shell for ./dev to evaluate, and on stderr what it does. FOLDER is for logs and environments.
"""
from __future__ import annotations

import importlib.metadata
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from processes import adopt_descendants, end_descendants, end_of_log

ROOT = Path(__file__).resolve().parents[1]
NOETIC = Path("/opt/ros/noetic/setup.bash")
LINTERS = ("ruff==0.17.5", "vermin==1.9.2")
# Debian's ROS modules that nodes on Python 3.8 import: plain Python, without the rest of what lies beside them.
MODULES38 = (
    "actionlib_msgs", "catkin", "diagnostic_msgs", "diagnostic_updater", "dynamic_reconfigure", "genmsg", "genpy",
    "geometry_msgs", "nav_msgs", "roscpp", "rosgraph", "rosgraph_msgs", "roslib", "rospy", "sensor_msgs", "std_msgs",
    "std_srvs", "tf2_msgs", "visualization_msgs")
PACKAGE_XML = ROOT / "package.xml"
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
    """Return the names of packages.

    Args:
        distribution: noetic, or debian.
        kind: ``apt``; ``pip``, what the distribution lacks; or ``alone``, what a Python without any of the
            distribution's packages needs, by pip.
    """
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


class SetUp:
    """Installs into this computer, and below a folder."""

    def __init__(self, folder: Path):
        self._folder = folder
        self.distribution = distribution()

    def ros(self) -> None:
        """Install what package.xml names and what the tests need; print the folder of what is from pip."""
        if self.distribution == "noetic":
            self._rosdep()
        self.apt(*packages(self.distribution, "apt"))
        # With the system's numpy.
        venv = self._venv("system", sys.executable, *packages(self.distribution, "pip"),
                          f"numpy=={importlib.metadata.version('numpy')}")
        (wheels,) = (venv / "lib").glob("python3*/site-packages")
        _print_shell(distribution=self.distribution, wheels=str(wheels))
        # roslaunch looks localhost up; a bare chroot has no /etc/hosts that knows it.
        if subprocess.run(["getent", "hosts", "localhost"], stdout=subprocess.DEVNULL, check=False).returncode:
            line = "127.0.0.1 localhost"
            if subprocess.run([*_as_root(), "sh", "-c", f"echo {line} >>/etc/hosts"], check=False).returncode:
                raise _end(f"add the line '{line}' to /etc/hosts")

    def build(self) -> None:
        """Install, and build the package in its workspace."""
        self.ros()
        workspace = self._folder.parent
        link = workspace / "src" / "car_interface"
        if not link.is_symlink() or link.resolve() != ROOT:
            link.unlink(missing_ok=True)
            link.symlink_to(ROOT)
        if not (workspace / "devel" / "setup.bash").exists():
            _say(f"Building in {workspace}")
        source = f". {NOETIC}; " if self.distribution == "noetic" else ""
        make = f"{source}exec catkin_make -C {shlex.quote(str(workspace))} -DPYTHON_EXECUTABLE={sys.executable}"
        # Where a message refers to others than it did before, make cannot know; cmake does.
        if not (self._run("build", "bash", "-c", make)
                or self._run("build", "bash", "-c", f"{make} --force-cmake", shows=True)):
            raise _end(f"the build failed; if the error is not in the package, remove {workspace} and try again")
        # Nodes that tests start write no byte code: without this each start compiles all that it imports.
        folders = str(link / "src"), str(workspace / "devel/lib/python3")
        subprocess.run([sys.executable, "-m", "compileall", "-q", *folders], stdout=subprocess.DEVNULL, check=False)

    def lint(self) -> None:
        """Install the linters; print their folder, and the Python that says what 3.8 can't compile."""
        self.apt("python3-venv")
        venv = self._venv("lint", sys.executable, *LINTERS)
        _print_shell(linters=str(venv / "bin"), python38=find_python38() or sys.executable)

    def pythons(self, *options: str) -> None:
        """Prepare the Pythons that the tests run on beside the system's; print what tells them apart."""
        if self.distribution == "debian":  # Ubuntu 20.04 has it only as a snap
            self.apt("chromium")
        python38 = None if sys.version_info[:2] == (3, 8) else find_python38()
        ready = []
        if python38:
            ready.append(self._other("3.8", python38))
            _print_shell(CAR_INTERFACE_PYTHON38=ready[0])
            if self.distribution == "debian":
                _print_shell(CAR_INTERFACE_PYTHONPATH38=self._modules38())
        else:
            _say(f"Python 3.8: none at hand beside the system's {sys.version.split()[0]}")
        newest = find_newest_python() if "--all" in options else None
        if newest:
            ready.append(self._other("newest", newest))
        print(f"pythons=({' '.join(f'--python {shlex.quote(python)}' for python in ready)})")

    def rviz(self) -> None:
        """Install rviz, which is large."""
        self.apt("ros-noetic-rviz" if self.distribution == "noetic" else "rviz")

    def apt(self, *names: str) -> None:
        """Install those packages that are missing."""
        listed = subprocess.run(["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\n", *names],
                                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False).stdout
        installed = {line.split()[0] for line in listed.splitlines() if line.endswith(" installed")}
        missing = [name for name in names if name not in installed]
        if not missing:
            return
        if os.geteuid() and not shutil.which("sudo"):
            raise _end("missing packages, and neither root nor sudo to install them: "
                       f"apt-get install {' '.join(missing)}")
        _say(f"Installing {len(missing)} packages: {' '.join(missing)}")
        apt = [*_as_root(), "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-y", "-q", "-o",
               "DPkg::Lock::Timeout=300"]
        # A repository that is down doesn't matter as long as the packages can be had: apt-get install decides.
        self._run("apt-update", *apt, "update")
        if not self._run("apt", *apt, "install", "--no-install-recommends", *missing, shows=True):
            raise _end("apt-get could not install the packages")

    def _rosdep(self):
        seen = self._folder / "rosdep.xml"
        if not shutil.which("rosdep") or seen.exists() and seen.read_bytes() == PACKAGE_XML.read_bytes():
            return
        _say("Installing what package.xml names with rosdep")
        # What is from pip is installed into an environment, without a change to the system.
        if not self._run("rosdep", "rosdep", "install", "--from-paths", str(ROOT), "--ignore-src", "--rosdistro",
                         "noetic", "-y", "--skip-keys", "python3-rosbags-pip python3-smbus2-pip rviz", shows=True):
            _say("rosdep failed: apt installs what is missing")
        shutil.copy(str(PACKAGE_XML), str(seen))

    def _other(self, name, python):
        """The Python of an environment; without one that can't be made a test counts as skipped."""
        try:
            self._venv(name, python, *packages(self.distribution, "alone"))
        except SystemExit as end:
            if end.code != 1:
                raise
            shutil.rmtree(str(self._folder / f"venv-{name}"), ignore_errors=True)
            _say(f"{python}: pip could not prepare it, which counts as 1 skipped")
        return str(self._folder / f"venv-{name}" / "bin" / "python")

    def _modules38(self):
        folder = self._folder / "ros-3.8"
        folder.mkdir(exist_ok=True)
        for module in MODULES38:
            link = folder / module
            if not link.is_symlink():
                link.symlink_to(f"/usr/lib/python3/dist-packages/{module}")
        return f"{self._folder.parent}/devel/lib/python3/dist-packages:{folder}"

    def _venv(self, name, python, *wanted):
        """Make a virtual environment, anew when Python or packages are others than before."""
        venv = self._folder / f"venv-{name}"
        version = subprocess.run([python, "-V"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
        made_of = " ".join((python, version, *wanted)) + "\n"
        record = venv / "made-of"
        if record.exists() and record.read_text(encoding="utf-8") == made_of:
            return venv
        _say(f"Installing with pip: {' '.join(wanted)}")
        system = ["--system-site-packages"] if python == sys.executable else []
        if not (self._run("venv", python, "-m", "venv", "--clear", *system, str(venv), shows=True)
                and self._run("pip", str(venv / "bin" / "python"), "-m", "pip", "install", "-q",
                              "--disable-pip-version-check", *wanted, shows=True)):
            raise _end(f"pip could not install {' '.join(wanted)}")
        record.write_text(made_of, encoding="utf-8")
        return venv

    def _run(self, name, *command, shows=False):
        """Run a command with its output in a log, of which the end is shown when it fails; whether it succeeded."""
        log = self._folder / "log" / f"{name}.log"
        with open(str(log), "wb") as file:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, check=False)
        if done.returncode and shows:
            print(end_of_log(log, 40), f"  (all of it: {log})", sep="\n", file=sys.stderr)
        return not done.returncode


def distribution() -> str:
    """Return noetic or debian, by what this computer is."""
    if NOETIC.exists():
        return "noetic"
    release = {}
    for line in Path("/etc/os-release").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition("=")
        release[name] = value.strip('"')
    system = release.get("ID"), release.get("VERSION_ID")
    if system in (("debian", "12"), ("raspbian", "12")):
        return "debian"
    if system == ("ubuntu", "20.04"):
        raise _end(f"there is no {NOETIC.parent}: install ros-noetic-ros-base as wiki.ros.org/noetic/Installation says")
    raise _end(f"this works on Debian 12 and on Ubuntu 20.04 with ROS Noetic in {NOETIC.parent}, and this is neither")


def find_python38() -> str | None:
    """Return a Python 3.8, or None."""
    candidates = [shutil.which("python3.8"), *map(str, _pyenv().glob("3.8*/bin/python"))]
    return next((path for path in candidates if path and _version(path) == (3, 8)), None)


def find_newest_python() -> str | None:
    """Return the newest one of pyenv that is newer than the system's, or None."""
    newer = {_version(path): str(path) for path in _pyenv().glob("3.*/bin/python")
             if _version(path) > sys.version_info[:2]}
    return newer[max(newer)] if newer else None


def _pyenv():
    return Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"


def _version(python):
    """The version of a Python, or (0, 0) where it can't be run."""
    try:
        done = subprocess.run([str(python), "-c", "import sys; print(*sys.version_info[:2])"], stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return (0, 0)
    major, minor = map(int, done.stdout.split())
    return (major, minor)


def _as_root():
    return ["sudo"] if os.geteuid() else []


def _print_shell(**values):
    for name, value in values.items():
        print(f"export {name}={shlex.quote(value)}")


def _say(line):
    print(line, file=sys.stderr, flush=True)


def _end(line):
    _say(f"./dev: {line}")
    return SystemExit(1)


if __name__ == "__main__":
    adopt_descendants(end_with_parent=True)
    try:
        os.environ.pop("PYTHONPATH", None)
        getattr(SetUp(Path(sys.argv[1])), sys.argv[2])(*sys.argv[3:])
    finally:
        end_descendants()
