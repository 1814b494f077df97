"""Files are replaced in one step, with mode and backup, and whatever happens nothing else is left."""
import errno
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from car_interface.common import atomic_file
from car_interface.common.atomic_file import replace
from car_interface.common.yaml_edit import save

ROOT = Path(__file__).resolve().parents[3]


def failing(number):
    """What an operation of the system does that fails with this errno."""
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))
    return fail


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"old")
    return path


@pytest.mark.parametrize("mode", [0o600, 0o664])
def test_new_content_is_in_place_with_the_mode_of_the_old_file_and_nothing_beside_it(path, mode):
    path.chmod(mode)
    assert replace(str(path), b"new", keeps_old=False) is None
    assert path.read_bytes() == b"new" and os.listdir(path.parent) == ["a.yaml"]
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_backups_of_the_same_second_do_not_overwrite_each_other(path, monkeypatch):
    monkeypatch.setattr(atomic_file.time, "strftime", lambda _: "now")
    names = [os.path.basename(replace(str(path), b"%d" % index, keeps_old=True)) for index in range(3)]
    assert names == ["a.yaml.bak-now", "a.yaml.bak-now-2", "a.yaml.bak-now-3"]
    assert [(path.parent / name).read_bytes() for name in names] == [b"old", b"0", b"1"]


def test_new_file_has_the_mode_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        assert replace(str(tmp_path / "b"), b"new", keeps_old=True) is None
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o640


# --- a process that is killed in a save ---

TEXT = "# of this car\n" + "".join(f"name_{index}: {index}  # why\n" for index in range(100)) + "servo_center: {}\n"
SAVES = """
import sys
from car_interface.common import atomic_file
from car_interface.common.yaml_edit import save
{change}
save(sys.argv[1], {{"servo_center": 0}})
"""
KILLS_ITSELF = "import os, signal; atomic_file.os.{} = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)"


def saving_process(path, change):
    return subprocess.Popen([sys.executable, "-c", SAVES.format(change=change), str(path)], stdout=subprocess.PIPE,
                            env={**os.environ, "PYTHONPATH": str(ROOT / "src")})


def not_in_place(folder):
    """The contents of the files that a save has not put in place yet."""
    return [path.read_text(encoding="utf-8") for path in folder.iterdir() if ".new-" in path.name]


@pytest.mark.parametrize("function", ["fsync", "link", "replace"])
def test_what_a_kill_leaves_is_removed_by_the_next_save(tmp_path, function):
    path = tmp_path / "turn_arb.yaml"
    path.write_text(TEXT.format("1"), encoding="utf-8")
    process = saving_process(path, KILLS_ITSELF.format(function))
    assert process.communicate()[0] == b"" and process.returncode == -signal.SIGKILL
    assert path.read_text(encoding="utf-8") == TEXT.format("1")
    assert not_in_place(tmp_path) == [TEXT.format("0")]
    aside = save(str(path), {"servo_center": 2})
    assert not_in_place(tmp_path) == []
    assert Path(aside).read_text(encoding="utf-8") == TEXT.format("1")


def test_save_does_not_remove_what_another_process_is_about_to_put_in_place(path, monkeypatch):
    move = os.replace

    def meanwhile(new_path, to_path):
        monkeypatch.setattr(atomic_file.os, "replace", move)
        assert replace(str(path), b"of another process", keeps_old=False) is None
        assert path.read_bytes() == b"of another process" and os.path.exists(new_path)
        move(new_path, to_path)
    monkeypatch.setattr(atomic_file.os, "replace", meanwhile)
    replace(str(path), b"new", keeps_old=False)
    assert path.read_bytes() == b"new" and os.listdir(path.parent) == ["a.yaml"]


def test_file_that_was_taken_for_left_over_before_it_was_locked_is_made_again(path, monkeypatch):
    lock, before = atomic_file._lock, []

    def late(fd):
        if not before:
            before.extend(other for other in path.parent.iterdir() if other != path)
            before[0].unlink()
        return lock(fd)
    monkeypatch.setattr(atomic_file, "_lock", late)
    replace(str(path), b"new", keeps_old=False)
    assert len(before) == 1 and path.read_bytes() == b"new" and os.listdir(path.parent) == ["a.yaml"]


def test_files_of_others_are_left_alone(path):
    names = [".a.yaml.new", ".a.yaml.new-mine", ".b.yaml.new-01234567", "a.yaml.new-01234567", ".a.yaml.new-012345678"]
    for name in names:
        (path.parent / name).write_bytes(b"")
    (path.parent / ".a.yaml.new-00000000").symlink_to(path.parent / names[0])
    (path.parent / ".a.yaml.new-00000001").mkdir()
    before = set(os.listdir(path.parent))
    replace(str(path), b"new", keeps_old=False)
    assert set(os.listdir(path.parent)) == before


def test_file_system_without_links_keeps_the_old_file_too(path, monkeypatch):
    monkeypatch.setattr(atomic_file.os, "link", failing(errno.EPERM))
    monkeypatch.setattr(atomic_file.time, "strftime", lambda _: "now")
    for index in range(2):
        replace(str(path), b"%d" % index, keeps_old=True)
    assert {other.name: other.read_bytes() for other in path.parent.iterdir()} == {
        "a.yaml": b"1", "a.yaml.bak-now": b"old", "a.yaml.bak-now-2": b"0"}


def test_backup_has_mode_and_time_of_the_old_file(path):
    path.chmod(0o640)
    os.utime(path, ns=(1_000_000_000, 2_000_000_000))
    backup = os.stat(replace(str(path), b"new", keeps_old=True))
    assert stat.S_IMODE(backup.st_mode) == 0o640 and backup.st_mtime_ns == 2_000_000_000


# --- a full disk ---

def test_copy_that_fails_on_a_file_system_without_links_leaves_nothing_behind(path, monkeypatch):
    monkeypatch.setattr(atomic_file.os, "link", failing(errno.EPERM))
    monkeypatch.setattr(atomic_file.shutil, "copyfileobj", failing(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left"):
        replace(str(path), b"new", keeps_old=True)
    assert path.read_bytes() == b"old" and os.listdir(path.parent) == ["a.yaml"]


@pytest.mark.parametrize("call, keeps_old", [
    ("fsync", False), ("fsync", True), ("fchmod", False), ("link", True), ("replace", False), ("replace", True)])
def test_failure_at_any_step_leaves_nothing_behind(path, monkeypatch, call, keeps_old):
    monkeypatch.setattr(atomic_file.os, call, failing(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left"):
        replace(str(path), b"new", keeps_old)
    assert path.read_bytes() == b"old" and os.listdir(path.parent) == ["a.yaml"]


def test_file_that_may_not_grow_is_not_half_written(tmp_path):
    path = tmp_path / "turn_arb.yaml"
    path.write_text(TEXT.format("1"), encoding="utf-8")
    process = saving_process(path, "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
                                   "sys.stderr = sys.stdout")
    assert b"can't be saved (File too large)" in process.communicate()[0]
    assert path.read_text(encoding="utf-8") == TEXT.format("1") and list(tmp_path.iterdir()) == [path]
