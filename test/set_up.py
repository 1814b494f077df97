"""Installs what a command of ./dev needs: packages by apt, the rest by pip in virtual environments.

    set_up.py FOLDER ros                   what package.xml names and what the tests need
    set_up.py FOLDER build                 the same; then it builds the package in the workspace above FOLDER
    set_up.py FOLDER lint                  the linters
    set_up.py FOLDER pythons [--all]       the other Pythons that the tests run on: 3.8, with --all also newer ones
    set_up.py FOLDER rviz                  rviz
    set_up.py FOLDER renew                 nothing; it pins the newest of pip's packages in test/requirements

It prints lines of shell for ./dev to evaluate, and on stderr what it does. FOLDER is for logs and environments.

ROS is what is in /opt/ros/one or /opt/ros/noetic, otherwise Debian's own packages; which system this is isn't asked.
"""
from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Iterable
from xml.etree import ElementTree

from processes import adopt_descendants, end_descendants, end_of_log

ROOT = Path(__file__).resolve().parents[1]
OPT = Path("/opt/ros")
PREFIXES = ("one", "noetic")  # ROS 1 in OPT/NAME, where package KEY is ros-NAME-KEY
DEBIAN = "Debian"  # Debian's own packages, as their ROS_DISTRO says
WHERE_ROS_IS = ("ROS 1 is in the packages of Debian 12 and 13, in ROS One (ros.packages.techfak.net, Ubuntu 22.04 and "
                "24.04) and in ROS Noetic (Ubuntu 20.04)")
# With a umask of 077 programs of packages would write files into the system that only root can read.
APT_GET = ("sh", "-c", 'umask 022; exec env LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive apt-get "$@"', "apt-get",
           "-y", "-q", "-o", "DPkg::Lock::Timeout=300")
DPKG_STATUS = Path("/var/lib/dpkg/status")  # written whenever a package is installed or removed
PYTHONS = ((3, 8), (3, 10), (3, 12), (3, 13))  # on which ./dev test --all runs, those at hand
LINTERS = ("ruff", "vermin")
COVERAGE = ("coverage",)
# What pip installs, pinned with the hashes of their files for every version of Python and every machine.
REQUIREMENTS = ROOT / "test" / "requirements"
RENEWS_WITH = ("uv",)
OLDEST_PYTHON = "3.8.10"  # Ubuntu 20.04's
# numpy, tornado and jinja2 of Ubuntu 20.04 and 22.04, Debian 12, Ubuntu 24.04, Debian 13: what pip adds must fit them.
# Ubuntu 20.04's tornado is called 6.0.3+really5.1.1.
OF_SYSTEMS = (("3.8", "1.17.4", "5.1.1", "2.10.1"), ("3.10", "1.21.5", "6.1", "3.0.3"),
              ("3.11", "1.24.2", "6.2", "3.1.2"), ("3.12", "1.26.4", "6.4", "3.1.2"),
              ("3.13", "2.2.4", "6.4.2", "3.1.6"))
BROUGHT = ("markupsafe",)  # by the system's jinja2, which needs its own: 2.10.1 fails with 2.1
# ROS modules that nodes on another Python import: plain Python, without the rest of what lies beside them.
ROS_MODULES = (
    "actionlib_msgs", "catkin", "diagnostic_msgs", "diagnostic_updater", "dynamic_reconfigure", "genmsg", "genpy",
    "geometry_msgs", "nav_msgs", "roscpp", "rosgraph", "rosgraph_msgs", "roslib", "rospy", "sensor_msgs", "std_msgs",
    "std_srvs", "tf2_msgs", "visualization_msgs")
PACKAGE_XML = ROOT / "package.xml"
# ROS packages that the commands and the tests call, and that package.xml need not name.
ROS_TOOLS = ("rosbash", "rosmsg", "rosout", "rosparam", "rosservice", "rostopic")
# The extra of setup.py: tools on several computers; 34 MB. Its last version for Python 3.8 wants tornado 6.0.3.
CLUSTER = ('distributed>=2023.5.0; python_version >= "3.9"',)
TOOLS = ("cmake", "g++", "iproute2", "make", "python3-pytest-xdist", "python3-venv")
DEBIAN_TOOLS = ("libfaketime", "ros-environment")
NOT_NEEDED = ("rviz",)  # large; `./dev demo --display` installs it
# Debian's packages of a ROS key, where they are not python3-KEY, or for messages also libKEY-dev.
DEBIAN_NAMES = {
    "catkin": ("catkin", "python3-catkin"),
    "diagnostic_msgs": ("python3-diagnostic-msgs",),
    "dynamic_reconfigure": ("libdynamic-reconfigure-config-init-mutex-dev", "python3-dynamic-reconfigure"),
    "message_generation": ("ros-message-generation",),
    "message_runtime": ("ros-message-runtime",),
    "rosbash": ("rosbash",),
    "rosgraph_msgs": ("python3-rosgraph-msgs",),
    "rosout": ("rosout",),
    "rostest": ("librostest-dev", "python3-rostest"),
    "rviz": ("rviz",),
}
CATKIN_PYTHON = ("PYTHON_EXECUTABLE", "Python_EXECUTABLE")  # for cmake's FindPythonInterp, and FindPython
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
    if distribution != DEBIAN:
        return (f"ros-{distribution}-{name}",)
    if key in DEBIAN_NAMES:
        return DEBIAN_NAMES[key]
    if key.endswith(("_msgs", "_srvs")):
        return (f"lib{name}-dev", f"python3-{name}")
    return (f"python3-{name}",)


def apt_packages(distribution: str, opt: Path = OPT) -> list[str]:
    """Return the names of apt's packages, without those of ROS that the distribution's prefix has by whatever way."""
    found = DEBIAN_TOOLS if distribution == DEBIAN else ()
    for key in (*keys(distribution), *ROS_TOOLS, *TOOLS):
        if not key.endswith("-pip") and not (opt / distribution / "share" / key / "package.xml").exists():  # REP 111
            found += apt_names(key, distribution)
    return sorted(set(found))


def pip_packages(distribution: str, is_alone: bool = False) -> list[str]:
    """Return the names of pip's packages: what the distribution lacks.

    Args:
        is_alone: for a Python without any of the distribution's packages, which needs more.
    """
    wanted = keys(distribution)
    named = [key for key in wanted if key.endswith("-pip")]
    if is_alone:
        named = [key for key in (*wanted, *TOOLS) if key.startswith("python3-") and key != "python3-venv"]
    return sorted({PIP.get(key, key[len("python3-"):].replace("-pip", "")) + wanted.get(key, "") for key in named})


def names_of(requirements: Iterable[str]) -> list[str]:
    """Return requirements without the bounds of their versions."""
    return [re.split("[<>=;]", each)[0] for each in requirements]


def pins() -> dict[str, tuple[list[str], list[str], list[str]]]:
    """Return by the name of a file of requirements: what is wanted, constraints, and what a system's packages have."""
    has = [f'{name}=={version}; python_version == "{python}"' for python, *versions in OF_SYSTEMS
           for name, version in zip(("numpy", "tornado", "jinja2"), versions)]
    debian, noetic = (set(pip_packages(name)) for name in (DEBIAN, "noetic"))
    of_noetic = [f'{name}; python_version == "3.8"' for name in sorted(noetic - debian)]
    alone = pip_packages(DEBIAN, is_alone=True)
    left_out = {*names_of(alone), *BROUGHT} - set(names_of(debian | noetic))
    return {"system": ([*sorted(debian), *of_noetic, *CLUSTER], has, sorted(left_out)), "alone": (alone, [], []),
            "lint": (list(LINTERS), [], []), "coverage": (list(COVERAGE), [], []), "renew": (list(RENEWS_WITH), [], [])}


def apt_failure(update_log: str, install_log: str) -> str:
    """Return why apt-get could not install packages, and what to do about it, in one line."""
    if re.search("Failed to fetch|Temporary failure|Could not resolve", update_log):
        return "apt-get could not fetch its lists of packages: connect this computer to the network, and try again"
    unknown = re.findall(r"(?:Unable to locate package |Package ')([\w.+-]+)", install_log)
    if "dpkg was interrupted" in install_log:
        return "an earlier installation was interrupted: run 'sudo dpkg --configure -a', and try again"
    refused = re.search(r"^(?:sudo: .*|.* is not in the sudoers file.*)$", install_log, re.MULTILINE)
    if refused:
        return f"no right to install packages ({refused[0]}): have an administrator of this computer run ./dev setup"
    if unknown:
        return f"apt has no package {', '.join(sorted(set(unknown)))} for this system; {WHERE_ROS_IS}"
    return "apt-get could not install the packages"


def pip_failure(log: str, pinned: str) -> str:
    """Return why pip could not install what a file of requirements names, and what to do about it, in one line."""
    refused = re.search(r"DO NOT MATCH THE HASHES.*?\n\s+(\S+).*? from ", log, re.DOTALL)
    if refused:
        return (f"pip was given another file of {refused[1]} than the one that {pinned} names, and installed nothing; "
                "without a reason for that don't trust the index or network")
    if re.search("Temporary failure in name resolution|NewConnectionError|ConnectTimeoutError", log):
        return f"pip could not fetch what {pinned} names: connect this computer to the network, and try again"
    return f"pip could not install what {pinned} names"


class SetUp:
    """Installs into this computer, and below a folder."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._system = folder / "venv-system" / "bin" / "python"
        self._built = folder.parent / "devel" / "built_of"  # build_inputs()
        self.distribution = distribution()

    def ros(self) -> None:
        """Install what package.xml names and what the tests need."""
        self.apt(*apt_packages(self.distribution))
        self._venv("system", sys.executable, "system")
        # roslaunch looks localhost up; a bare chroot has no /etc/hosts that knows it.
        if subprocess.run(["getent", "hosts", "localhost"], stdout=subprocess.DEVNULL, check=False).returncode:
            line = "127.0.0.1 localhost"
            if subprocess.run([*_as_root(), "sh", "-c", f"echo {line} >>/etc/hosts"], check=False).returncode:
                raise _end(f"add the line '{line}' to /etc/hosts")

    def build(self) -> None:
        """Install, and build the package in its workspace, unless nothing has changed that either depends on."""
        if self._is_built():
            return
        with open(str(self._folder / "build.lock"), "w", encoding="ascii") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                _say(f"Waiting for another ./dev that builds in {self._folder.parent}")
                fcntl.flock(lock, fcntl.LOCK_EX)
            if not self._is_built():
                self._remove_other_build()
                self.ros()
                inputs = build_inputs(self.distribution)
                self._make()
                self._built.write_text(inputs, encoding="utf-8")

    def _is_built(self):
        return self._system.exists() and _text_of(self._built) == build_inputs(self.distribution)

    def _remove_other_build(self):
        """What another ROS or Python has built can't be built upon."""
        before = _text_of(self._built).split("\n")[0]
        self._built.unlink(missing_ok=True)
        if before not in ("", build_inputs(self.distribution).split("\n")[0]):
            for name in ("build", "devel"):
                shutil.rmtree(str(self._folder.parent / name), ignore_errors=True)

    def _make(self):
        workspace = self._folder.parent
        link = workspace / "src" / "car_interface"
        if not link.is_symlink() or link.resolve() != ROOT:
            link.unlink(missing_ok=True)
            link.symlink_to(ROOT)
        if not (workspace / "devel" / "setup.bash").exists():
            _say(f"Building in {workspace}")
        source = "" if self.distribution == DEBIAN else f". {OPT / self.distribution}/setup.bash; "
        # The scripts that rosrun finds start with this Python, which has rosbags, whatever PATH and PYTHONPATH say.
        python = " ".join(f"-D{name}={shlex.quote(str(self._system))}" for name in CATKIN_PYTHON)
        make = f"{source}exec catkin_make -C {shlex.quote(str(workspace))} {python}"
        # Where a message refers to others than it did before, make cannot know; cmake does.
        if not (self._run("build", "bash", "-c", make)
                or self._run("build", "bash", "-c", f"{make} --force-cmake", shows=True)):
            raise _end(f"the build failed; if the error is not in the package, remove {workspace} and try again")
        self._compile()

    def _compile(self):
        """Compile once what nodes that start at the same time would each compile."""
        workspace = self._folder.parent
        folders = str(workspace / "src/car_interface/src"), str(workspace / "devel/lib/python3")
        subprocess.run([sys.executable, "-m", "compileall", "-q", *folders], stdout=subprocess.DEVNULL, check=False)

    def lint(self) -> None:
        """Install the linters; print their folder, and the Python that says what 3.8 can't compile."""
        self.apt("python3-venv")
        venv = self._venv("lint", sys.executable, "lint")
        _print_shell(linters=str(venv / "bin"))

    def pythons(self, *options: str) -> None:
        """Prepare the Pythons that the tests run on beside the system's; print what tells them apart."""
        self._compile()
        if subprocess.run(["apt-cache", "show", "chromium"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                          check=False).returncode == 0:  # Ubuntu has it only as a snap
            self.apt("chromium")
        versions = [version for version in PYTHONS if version != sys.version_info[:2]]
        found = find_pythons(versions if "--all" in options else [PYTHONS[0]])
        if not found:
            _say(f"no Python {PYTHONS[0][0]}.{PYTHONS[0][1]} at hand beside the system's {sys.version.split()[0]}")
        ready = {version: self._other(".".join(map(str, version)), python, "alone")
                 for version, python in found.items()}
        if PYTHONS[0] in ready:
            _print_shell(CAR_INTERFACE_PYTHON38=ready[PYTHONS[0]])
        _print_shell(CAR_INTERFACE_OTHER_PYTHONPATH=self._ros_modules())
        arguments = [f"--python {shlex.quote(python)}" for python in ready.values()]
        if "--all" in options:
            coverage = self._other("coverage", sys.executable, "coverage")
            arguments.append(f"--coverage {shlex.quote(coverage)}")
        print(f"pythons=({' '.join(arguments)})")

    def rviz(self) -> None:
        if not (OPT / self.distribution / "share/rviz").exists():
            self.apt(*apt_names("rviz", self.distribution))

    def apt(self, *names: str) -> None:
        """Install those packages that are missing."""
        missing = [name for name in names if name not in _installed(names)]
        if not missing:
            return
        if not shutil.which("apt-get"):
            raise _end(f"there is no apt here to install {' '.join(missing)}; {WHERE_ROS_IS}")
        if os.geteuid() and not shutil.which("sudo"):
            raise _end("missing packages, and neither root nor sudo to install them: "
                       f"apt-get install {' '.join(missing)}")
        _say(f"Installing {len(missing)} packages: {' '.join(missing)}")
        apt = [*_as_root(), *APT_GET]
        # A repository that is down doesn't matter as long as the packages can be had: apt-get install decides.
        self._run("apt-update", *apt, "update")
        if not self._run("apt", *apt, "install", "--no-install-recommends", *missing, shows=True):
            raise _end(apt_failure(*(_text_of(self._folder / "log" / name) for name in ("apt-update.log", "apt.log"))))

    def _other(self, name, python, kind):
        """The Python of an environment; without one that can't be made a test counts as skipped."""
        try:
            self._venv(name, python, kind)
        except SystemExit as end:
            if end.code != 1:
                raise
            shutil.rmtree(str(self._folder / f"venv-{name}"), ignore_errors=True)
            _say(f"{python}: pip could not prepare it, which counts as 1 skipped")
        return str(self._folder / f"venv-{name}" / "bin" / "python")

    def _ros_modules(self):
        """PYTHONPATH with ROS and the generated messages for a Python that is not the system's."""
        folder = self._folder / "ros_modules"
        prefix = Path("/usr") if self.distribution == DEBIAN else OPT / self.distribution
        shutil.rmtree(str(folder), ignore_errors=True)
        folder.mkdir()
        for module in ROS_MODULES:
            (folder / module).symlink_to(prefix / "lib/python3/dist-packages" / module)
        return f"{self._folder.parent}/devel/lib/python3/dist-packages:{folder}"

    def renew(self) -> None:
        """Pin the newest packages, from the index that pip is configured for, on every Python from the oldest on."""
        (self._folder / "log").mkdir(parents=True, exist_ok=True)
        venv = self._venv("renew", sys.executable, "renew")
        # Only the main index has all files of a release, for other machines, too; extra ones often have some.
        index = os.environ.get("PIP_INDEX_URL") or subprocess.run(
            [str(venv / "bin/pip"), "config", "get", "global.index-url"], stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, check=False).stdout.strip()
        if index:
            os.environ["UV_DEFAULT_INDEX"] = index
        constraints = self._folder / "constraints.txt"
        for kind, (wanted, constrained, left_out) in pins().items():
            _say(f"Pinning {kind}")
            constraints.write_text("\n".join(constrained), encoding="utf-8")
            wanted_file, target = self._folder / "wanted.txt", REQUIREMENTS / f"{kind}.txt"
            wanted_file.write_text("\n".join(wanted), encoding="utf-8")
            if not self._run("renew", str(venv / "bin/uv"), "pip", "compile", "--no-config", "--no-python-downloads",
                             "--universal", "--upgrade", "--generate-hashes", "--no-header", "--no-annotate",
                             "--python-version", OLDEST_PYTHON,
                             *(f"--no-emit-package={name}" for name in left_out), "-c", str(constraints),
                             "-o", str(target), str(wanted_file), shows=True):
                raise _end(f"the packages of {target.name} could not be pinned")

    def _venv(self, name, python, kind):
        """Make a virtual environment of what test/requirements pins, anew when that or Python is another than before.

        pip installs only files with these hashes, and nothing that isn't named there.
        """
        venv, pinned = self._folder / f"venv-{name}", REQUIREMENTS / f"{kind}.txt"
        version = subprocess.run([python, "-V"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
        made_of = f"{python} {version} {hashlib.sha256(pinned.read_bytes()).hexdigest()}\n"
        record = venv / "made-of"
        if record.exists() and record.read_text(encoding="utf-8") == made_of:
            return venv
        _say(f"Installing with pip what {pinned.relative_to(ROOT)} names")
        system = ["--system-site-packages"] if python == sys.executable else []
        if not self._run("venv", python, "-m", "venv", "--clear", *system, str(venv), shows=True):
            raise _end(f"{python} could not make a virtual environment")
        if not self._run("pip", str(venv / "bin" / "python"), "-m", "pip", "install", "-q", "--no-deps",
                         "--disable-pip-version-check", "--require-hashes", "-r", str(pinned)):
            log = self._folder / "log" / "pip.log"
            failure = pip_failure(_text_of(log), f"test/requirements/{kind}.txt")
            if failure.startswith("pip could not install"):
                print(end_of_log(log, 40), file=sys.stderr)
            raise _end(failure)
        record.write_text(made_of, encoding="utf-8")
        return venv

    def _run(self, name, *command, shows=False):
        """Run a command with its output in a log, of which the end is shown when it fails; whether it succeeded."""
        log = self._folder / "log" / f"{name}.log"
        with open(str(log), "wb") as file:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, check=False)
        if done.returncode and shows:
            print(end_of_log(log, 40), file=sys.stderr)
        return not done.returncode


def distribution(opt: Path = OPT) -> str:
    """Return which ROS is installed: one or noetic in /opt/ros, otherwise Debian's, which can be installed."""
    return next((name for name in PREFIXES if (opt / name / "setup.bash").exists()), DEBIAN)


def build_inputs(ros: str) -> str:
    """Return what a build depends on: the first line for a whole one, then the files that catkin reads, and apt's."""
    lines = [f"{ros} {sys.version.split()[0]} {ROOT}"]
    names = ("CMakeLists.txt", "setup.py", "package.xml", "msg/*", "srv/*", "cfg/*", "test/set_up.py",
             "test/requirements/*")
    for path in sorted(path for name in names for path in ROOT.glob(name)):
        lines.append(f"{hashlib.sha256(path.read_bytes()).hexdigest()} {path.relative_to(ROOT)}")
    if DPKG_STATUS.exists():
        lines.append(f"{DPKG_STATUS.stat().st_mtime_ns} {DPKG_STATUS}")
    return "\n".join(lines)


def find_pythons(versions: Iterable[tuple[int, int]]) -> dict[tuple[int, int], str]:
    """Return the Pythons of these versions that are at hand: pyenv's and those on PATH."""
    found = {}
    for version in versions:
        name = ".".join(map(str, version))
        candidates = [*map(str, sorted(_pyenv().glob(f"{name}.*/bin/python"))), shutil.which(f"python{name}")]
        python = next((path for path in candidates if path and _version(path) == version), None)
        if python:
            found[version] = python
    return found


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


def _installed(names):
    """The packages of these that dpkg has; none where there is no dpkg."""
    try:
        done = subprocess.run(["dpkg-query", "-W", "-f", "${Package} ${db:Status-Status}\n", *names],
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    except FileNotFoundError:
        return set()
    return {line.split()[0] for line in done.stdout.splitlines() if line.endswith(" installed")}


def _text_of(path):
    return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""


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
