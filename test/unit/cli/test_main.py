"""The commands on a laptop without ROS: what they are called, what they say, how they end; and what pip installs."""
from __future__ import annotations

import argparse
import ast
import importlib
import os
import shutil
import subprocess
import sys
import types
from functools import partial
from pathlib import Path

import pytest

from car_interface.cli import jobs, output
from car_interface.cli import main as command_line
from car_interface.cli.main import MODULES, main
from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file
from car_interface.steering.params import load_steering

ROOT = Path(__file__).resolve().parents[3]
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


def test_fault_of_our_own_is_not_hidden(command):
    command.run = raising(ModuleNotFoundError("no", name="car_interface.typo"))
    with pytest.raises(ModuleNotFoundError):
        main("try", [])


def test_ctrl_c_ends_without_a_word(command, capsys):
    command.run = raising(KeyboardInterrupt())
    assert main("try", []) == 130
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["try", "--unknown"], ["try", "--number", "x"]])
def test_what_is_not_understood_is_2(command, arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(None, arguments)
    assert caught.value.code == 2 and "usage: car-interface" in capsys.readouterr().err


def test_help_has_a_line_for_each_command_and_all_of_one(command, capsys):
    for arguments, words in ((["--help"], "Tries it."), (["try", "--help"], "More about that.")):
        with pytest.raises(SystemExit) as caught:
            main(None, arguments)
        assert caught.value.code == 0 and words in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(MODULES))
def test_each_command_keeps_the_contract(name):
    module = importlib.import_module(MODULES[name])
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    assert callable(module.run) and module.__doc__.strip().split("\n")[0].endswith((".", "?"))
    assert all(action.help for action in parser._actions), "an option without a help"


def test_output_that_nobody_reads_any_more_is_no_fault():
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run([sys.executable, "-B", "-m", "car_interface.cli.main", "check_map", str(TABLE)],
                              env={"PYTHONPATH": path_for_children()}, stdout=write, stderr=subprocess.PIPE, text=True,
                              check=False)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


def path_for_children():
    return os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])


@pytest.mark.parametrize("name", sorted(MODULES))
def test_rosrun_finds_a_script(name):
    assert name in {path.name for path in (ROOT / "scripts").iterdir()}


# --- several recordings at once ---


def squared(number):
    return number * number


def refusing(number):
    raise CarInterfaceError(f"{number} is refused")


def leaving_a_mark(folder, number):
    (folder / str(number)).touch()
    if number == 0:
        raise CarInterfaceError("0 is refused")


def dying(number):
    os._exit(9)


@pytest.mark.parametrize("count", [1, 3, 20])
def test_work_in_processes_comes_back_in_order(count):
    assert list(jobs.for_each(squared, list(range(7)), count)) == [0, 1, 4, 9, 16, 25, 36]


@pytest.mark.parametrize("count", [1, 2])
def test_error_of_this_package_comes_back_as_it_is(count):
    with pytest.raises(CarInterfaceError, match="1 is refused"):
        list(jobs.for_each(refusing, [1, 2], count))


@pytest.mark.parametrize("count", [1, 2])
def test_error_ends_the_work(count, tmp_path):
    with pytest.raises(CarInterfaceError, match="0 is refused"):
        list(jobs.for_each(partial(leaving_a_mark, tmp_path), range(1000), count))
    assert len(list(tmp_path.iterdir())) < 100


def test_process_that_was_killed_is_told():
    with pytest.raises(CarInterfaceError, match="was killed, maybe for want of memory: try again with --jobs 1"):
        list(jobs.for_each(dying, [1, 2], 2))


@pytest.mark.parametrize("text", ["0", "-1", "x", ""])
def test_number_of_jobs_must_be_one(text, capsys):
    parser = argparse.ArgumentParser()
    jobs.add_jobs_argument(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(["--jobs", text])
    assert "no number of at least 1" in capsys.readouterr().err


# --- what is installed ---


def test_files_of_the_package_are_found_in_the_checkout():
    assert package_file("msg") == ROOT / "msg" and package_file("config/turn_arb.yaml") == TABLE
    with pytest.raises(CarInterfaceError, match="no_such_file of car_interface is missing"):
        package_file("no_such_file")


@pytest.mark.parametrize("modules", ["lib/python3/dist-packages", "lib/python3.11/site-packages", "."],
                         ids=["catkin_install", "venv", "pip_target"])
def test_files_of_the_package_are_found_where_it_is_installed(modules, tmp_path):
    for name in ("__init__.py", "common/__init__.py", "common/errors.py", "common/package_files.py"):
        target = tmp_path / modules / "car_interface" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(str(ROOT / "src/car_interface" / name), str(target))
    shutil.copytree(str(ROOT / "msg"), str(tmp_path / "share/car_interface/msg"))
    code = "from car_interface.common.package_files import package_file; print(package_file('msg'))"
    done = subprocess.run([sys.executable, "-B", "-c", code], env={"PYTHONPATH": str(tmp_path / modules)},
                          capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == (str(tmp_path.resolve() / "share/car_interface/msg"), "")


def setup_arguments():
    """What setup.py hands to setup(), as catkin and pip see it."""
    found = {}
    setuptools = types.ModuleType("setuptools")
    setuptools.setup = lambda **arguments: found.update(arguments)
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


def test_setup_takes_name_and_version_from_package_xml_and_needs_no_catkin():
    found = setup_arguments()
    assert found["name"] == "car_interface" and found["version"].count(".") == 2
    assert found["package_dir"] == {"": "src"}
    imported = {name.name for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8")))
                if isinstance(node, ast.Import) for name in node.names}
    assert "catkin_pkg" not in imported


def test_setup_ships_every_message_definition_and_the_stock_configuration():
    shipped = {name for _, names in setup_arguments()["data_files"] for name in names}
    wanted = {path.relative_to(ROOT).as_posix() for pattern in ("msg/*.msg", "config/*.yaml", "config/*.csv")
              for path in ROOT.glob(pattern)}
    assert shipped == wanted
    assert {folder for folder, _ in setup_arguments()["data_files"]} == {"share/car_interface/msg",
                                                                         "share/car_interface/config"}


def test_setup_makes_the_command_and_names_what_it_needs():
    found = setup_arguments()
    assert found["entry_points"] == {"console_scripts": ["car-interface = car_interface.cli.main:main"]}
    libraries = {"matplotlib", "numpy", "PyYAML", "rosbags", "scipy", "tqdm"}
    assert {need.split(">")[0] for need in found["extras_require"]["tools"]} == libraries


# --- what they write ---


def kept_beside(path):
    return [other for other in path.parent.iterdir() if other.name.startswith(f"{path.name}.bak-")]


def test_new_file_has_the_usual_permissions_and_nothing_lies_beside_it(tmp_path):
    assert output.write(str(tmp_path / "a"), "¼ m", keeps_old=True) is None
    assert (tmp_path / "a").read_text(encoding="utf-8") == "¼ m"
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~mask
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("keeps_old", [False, True])
def test_replaced_file_keeps_its_mode_and_is_kept_on_request(tmp_path, keeps_old):
    path = tmp_path / "a"
    path.write_text("old")
    path.chmod(0o640)
    aside = output.write(str(path), b"new", keeps_old)
    assert path.read_text() == "new" and path.stat().st_mode & 0o777 == 0o640
    assert [str(other) for other in kept_beside(path)] == ([aside] if keeps_old else [])
    assert not keeps_old or Path(aside).read_text() == "old"


@pytest.mark.skipif(os.getuid() != 0, reason="only root may give files away")
def test_replaced_file_keeps_its_owner(tmp_path):
    path = tmp_path / "a"
    path.write_text("old")
    os.chown(str(path), 1234, 2345)
    output.write(str(path), "new")
    assert (path.stat().st_uid, path.stat().st_gid) == (1234, 2345)


@pytest.mark.parametrize("target_exists", [True, False])
def test_link_stays_a_link_and_its_target_is_written(tmp_path, target_exists):
    target, link = tmp_path / "mine" / "a", tmp_path / "link"
    target.parent.mkdir()
    if target_exists:
        target.write_text("old")
    link.symlink_to(target)
    output.check(str(link))
    output.write(str(link), "new")
    assert link.is_symlink() and target.read_text() == "new"


def test_what_is_no_file_is_written_to_as_it_is(tmp_path, capfd):
    for path in ("/dev/null", "/dev/stdout"):
        output.check(path)
        assert output.write(path, "hello", keeps_old=True) is None
    assert capfd.readouterr().out == "hello"
    assert not Path("/dev/null").is_file()


def test_half_written_file_is_none(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_text("old")

    def full(handle):
        raise OSError(28, "No space left on device")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CarInterfaceError, match=f"{path} can't be written: No space left on device"):
        output.write(str(path), "new", keeps_old=True)
    assert [(other.name, other.read_text()) for other in tmp_path.iterdir()] == [("a", "old")]


def folder(tmp_path):
    return tmp_path, "is a folder"


def new_folder(tmp_path):
    return f"{tmp_path}/new/", "is a folder"


def in_no_folder(tmp_path):
    return tmp_path / "none" / "a", "there is no folder"


def recording_given(tmp_path):
    (tmp_path / "given.bag").touch()
    return tmp_path / "given.bag", "is one of the recordings"


def link_to_recording_given(tmp_path):
    (tmp_path / "given.bag").touch()
    (tmp_path / "a.html").symlink_to(tmp_path / "given.bag")
    return tmp_path / "a.html", "is one of the recordings"


def other_recording(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"#ROSBAG V2.0\n")
    return tmp_path / "a.yaml", "is a recording, and would be lost"


def protected(tmp_path):
    (tmp_path / "a.yaml").touch(mode=0o444)
    return tmp_path / "a.yaml", "is write-protected"


@pytest.mark.parametrize("made", [folder, new_folder, in_no_folder, recording_given, link_to_recording_given,
                                  other_recording, protected], ids=lambda made: made.__name__)
def test_output_that_can_not_be_or_would_be_a_loss_is_refused_by_the_name_it_was_given(made, tmp_path):
    path, words = made(tmp_path)
    with pytest.raises(CarInterfaceError, match=f"^{path} [^\n]*{words}[^\n]*$"):
        output.check(str(path), [str(tmp_path / "given.bag")])


def test_folder_without_permission_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: path != str(tmp_path))  # root may write everywhere
    with pytest.raises(CarInterfaceError, match=f"a can't be written: no permission in the folder {tmp_path}"):
        output.check(str(tmp_path / "a"))


def test_loader_that_refuses_a_text_names_the_output(tmp_path):
    path = str(tmp_path / "mine.yaml")
    with pytest.raises(CarInterfaceError, match=f"^{path}, servo_left is missing"):
        output.check_content(path, "servo_channel: 0\n", load_steering)
    assert list(tmp_path.iterdir()) == []
