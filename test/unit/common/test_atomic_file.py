"""Files are replaced in one step, with mode and backup."""
from __future__ import annotations

import os
import re
import stat

import pytest

from car_interface.common import atomic_file
from car_interface.common.atomic_file import is_write_protected, replace


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_bytes(b"old")
    return path


def test_new_content_is_in_place_and_nothing_beside_it(path):
    assert replace(str(path), b"new", keeps_old=False) is None
    assert path.read_bytes() == b"new" and os.listdir(path.parent) == ["a.yaml"]


def test_backup_has_the_old_content_and_the_time_in_its_name(path):
    backup_path = replace(str(path), b"new", keeps_old=True)
    assert re.fullmatch(r".*/a\.yaml\.bak-\d{8}-\d{6}", backup_path)
    with open(backup_path, "rb") as backup:
        assert backup.read() == b"old"


def test_backups_of_the_same_second_do_not_overwrite_each_other(path, monkeypatch):
    monkeypatch.setattr(atomic_file.time, "strftime", lambda _: "now")
    names = [os.path.basename(replace(str(path), b"%d" % index, keeps_old=True)) for index in range(3)]
    assert names == ["a.yaml.bak-now", "a.yaml.bak-now-2", "a.yaml.bak-now-3"]
    assert [(path.parent / name).read_bytes() for name in names] == [b"old", b"0", b"1"]


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o664])
def test_mode_of_the_old_file_is_kept(path, mode):
    path.chmod(mode)
    replace(str(path), b"new", keeps_old=False)
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_new_file_has_the_mode_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        assert replace(str(tmp_path / "b"), b"new", keeps_old=True) is None
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o640


def test_failed_write_changes_nothing(path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")
    monkeypatch.setattr(atomic_file.os, "replace", fail)
    with pytest.raises(OSError, match="No space left"):
        replace(str(path), b"new", keeps_old=False)
    assert path.read_bytes() == b"old" and os.listdir(path.parent) == ["a.yaml"]


def test_write_protection_goes_by_the_mode_also_for_root(path):
    assert not is_write_protected(str(path))
    path.chmod(0o444)
    assert is_write_protected(str(path))
