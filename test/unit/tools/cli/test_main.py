"""The commands on a laptop without ROS: what they are called, what they say, how they end; and what pip installs."""
import argparse
import importlib
import os
import subprocess
import sys
import types
from pathlib import Path
from xml.etree import ElementTree

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli import main as command_line
from car_interface.tools.cli.main import MODULES, main

ROOT = Path(__file__).resolve().parents[4]
TABLE = ROOT / "config" / "turn_arb.yaml"


@pytest.fixture
def command(monkeypatch):
    """A command ``try`` that does what the test says."""
    module = types.ModuleType("tried")
    module.__doc__ = "Tries it.\n\nMore about that."
    module.add_arguments = lambda parser: parser.add_argument("--number", type=int, default=0)
    module.run = lambda options: options.number
    monkeypatch.setitem(sys.modules, "tried", module)
    monkeypatch.setattr(command_line, "MODULES", {"try": "tried"})
    return module


def raising(error):
    def run(options):
        raise error
    return run


@pytest.mark.parametrize("name, arguments", [(None, ["try", "--number", "3"]), ("try", ["--number", "3"])],
                         ids=["car-interface_try", "rosrun_try"])
def test_command_runs_either_way_and_its_exit_code_is_passed_on(command, name, arguments):
    assert main(name, arguments) == 3


@pytest.mark.parametrize("error, words", [
    pytest.param(CarInterfaceError("no such bag"), "no such bag", id="refused"),
    pytest.param(OSError(28, "No space left on device", "/out.html"), "/out.html: No space left", id="disk_full"),
    pytest.param(ModuleNotFoundError("no", name="rosbags.highlevel"), "this needs rosbags, which isn't installed",
                 id="library_missing"),
    pytest.param(ModuleNotFoundError("no", name="yaml"), "this needs PyYAML", id="library_of_another_name"),
])
def test_what_goes_wrong_ends_as_one_line_and_1(command, error, words, capsys):
    command.run = raising(error)
    assert main("try", []) == 1
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.startswith("try: ") and words in shown.err and shown.err.count("\n") == 1


def test_ctrl_c_ends_without_a_word_and_a_fault_of_our_own_is_not_hidden(command, capsys):
    command.run = raising(KeyboardInterrupt())
    assert main("try", []) == 130
    assert capsys.readouterr().err == ""
    command.run = raising(ModuleNotFoundError("no", name="car_interface.typo"))
    with pytest.raises(ModuleNotFoundError):
        main("try", [])


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["try", "--unknown"], ["try", "--number", "x"]])
def test_what_is_not_understood_is_2(command, arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(None, arguments)
    assert caught.value.code == 2 and "usage: car-interface" in capsys.readouterr().err


@pytest.mark.more
def test_output_that_nobody_reads_any_more_is_no_fault():
    read, write = os.pipe()
    os.close(read)
    path = os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])
    try:
        done = subprocess.run([sys.executable, "-B", "-m", "car_interface.tools.cli.main", "check_map", str(TABLE)],
                              env={"PYTHONPATH": path}, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


# --- what is installed ---

def setup_arguments():
    """What setup.py hands to setup(), as catkin and pip see it."""
    found = {}
    setuptools = types.ModuleType("setuptools")
    setuptools.setup = lambda **arguments: found.update(arguments)
    setuptools.find_packages = lambda _: []
    before = sys.modules.get("setuptools")
    sys.modules["setuptools"] = setuptools
    try:
        source = (ROOT / "setup.py").read_text(encoding="utf-8")
        exec(compile(source, str(ROOT / "setup.py"), "exec"), {"__file__": str(ROOT / "setup.py"), "__name__": "setup"})
    finally:
        if before is None:
            del sys.modules["setuptools"]
        else:
            sys.modules["setuptools"] = before
    return found


def test_setup_ships_every_message_definition_the_stock_configuration_and_every_file_of_a_page():
    shipped = {name for _, names in setup_arguments()["data_files"] for name in names}
    wanted = {path.relative_to(ROOT).as_posix() for pattern in ("msg/*.msg", "config/*.yaml", "config/*.csv")
              for path in ROOT.glob(pattern)}
    assert shipped == wanted
    assert {folder for folder, _ in setup_arguments()["data_files"]} == {"share/car_interface/msg",
                                                                         "share/car_interface/config"}
    shipped = {path for package, patterns in setup_arguments()["package_data"].items() for pattern in patterns
               for path in (ROOT / "src" / package.replace(".", "/")).glob(pattern)}
    assert shipped == {path for path in (ROOT / "src").rglob("*") if path.suffix in (".html", ".css", ".js", ".svg")}


def test_setup_makes_the_command_and_names_what_it_needs():
    found = setup_arguments()
    assert (found["name"], found["package_dir"]) == ("car_interface", {"": "src"})
    assert found["entry_points"] == {"console_scripts": ["car-interface = car_interface.tools.cli.main:main"]}
    tools = {need.split(">")[0]: need for need in found["extras_require"]["tools"]}
    assert set(tools) == {"Jinja2", "matplotlib", "numpy", "PyYAML", "rosbags", "scipy", "tqdm"}
    package = ElementTree.parse(str(ROOT / "package.xml")).getroot()
    (depend,) = [item for item in package.iter("exec_depend") if item.text == "python3-rosbags-pip"]
    assert tools["rosbags"] == f"rosbags>={depend.get('version_gte')},<={depend.get('version_lte')}", "as for ROS"


# --- help and version ---

@pytest.mark.parametrize("name", sorted(MODULES))
def test_every_command_is_started_by_rosrun_and_answers_help_with_a_text_for_each_option(name, capsys):
    module, parser = importlib.import_module(MODULES[name]), argparse.ArgumentParser()
    module.add_arguments(parser)
    assert all(action.help for action in parser._actions) and (ROOT / "scripts" / name).exists()
    for arguments, usage in (((name, ["--help"]), name), ((None, [name, "--help"]), f"car-interface {name}")):
        with pytest.raises(SystemExit) as caught:
            main(*arguments)
        shown = capsys.readouterr()
        assert caught.value.code == 0 and shown.err == "" and shown.out.startswith(f"usage: {usage}")


@pytest.mark.parametrize("command_name, arguments", [
    (None, ["--version"]), (None, ["check_map", "--version"]), ("check_map", ["--version"])],
    ids=["car-interface", "car-interface_check_map", "rosrun_check_map"])
def test_version_is_that_of_the_package(command_name, arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(command_name, arguments)
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"car_interface {setup_arguments()['version']}\n"


def test_version_is_the_one_in_package_xml_else_the_metadata_s_and_is_refused_without_either(monkeypatch):
    monkeypatch.setattr(command_line.metadata, "version", {"car_interface": "1.2.3"}.__getitem__)
    assert command_line.version() == ElementTree.parse(str(ROOT / "package.xml")).findtext("version")
    def missing_file(name):
        raise CarInterfaceError(name)

    def unknown(name):
        raise command_line.metadata.PackageNotFoundError(name)
    monkeypatch.setattr(command_line, "package_file", missing_file)
    monkeypatch.setattr(command_line.metadata, "version", {"car_interface": "1.2.3"}.__getitem__)
    assert command_line.version() == "1.2.3"
    monkeypatch.setattr(command_line.metadata, "version", unknown)
    with pytest.raises(CarInterfaceError, match=r"has neither package\.xml nor metadata"):
        command_line.version()
