"""What was read before is kept, and is used only if nothing has changed."""
import os

import pytest

from car_interface.tools.cli import drives
from car_interface.tools.cli.drives import CACHE, find_recordings, fingerprint, load_rows, save_rows
from car_interface.tools.report.drives import Row

STATE = [100, 5]
ROW = Row("a.bag", start_ns=1, duration_s=2.0, losses={"e_stop": 1}, lacks=["/rosout"], notes=[], left_ratio=1.05)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """The user's cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "car_interface"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "drives").mkdir()
    assert save_rows(str(tmp_path / "drives"), "1", {"a.bag": (STATE, ROW)}) == ""
    return str(tmp_path / "drives")


def test_rows_are_kept_with_their_recordings_state_for_one_version(folder):
    rows, note = load_rows(folder, "1")
    ((path, (state, row)),) = rows.items()
    assert (path, state, row._asdict(), note) == ("a.bag", STATE, ROW._asdict(), "")
    assert load_rows(folder, "2") == ({}, "")


@pytest.mark.parametrize("damage", [
    pytest.param(lambda text: "", id="empty"),
    pytest.param(lambda text: text[:100], id="cut_off"),
    pytest.param(lambda text: text.replace("1.05", "9.05"), id="another_number"),
    pytest.param(lambda text: "garbage\n{}\n", id="garbage"),
    pytest.param(lambda text: text.replace("a", "ä"), id="not_ascii"),
])
def test_damaged_file_is_said_and_replaced(folder, damage):
    path = os.path.join(folder, CACHE)
    with open(path, encoding="utf-8") as file:
        text = file.read()
    with open(path, "w", encoding="utf-8") as file:
        file.write(damage(text))
    assert load_rows(folder, "1") == ({}, f"{path} is damaged: all recordings are read again")
    assert save_rows(folder, "1", {"a.bag": (STATE, ROW)}) == "" and list(load_rows(folder, "1")[0]) == ["a.bag"]


def test_what_is_no_file_or_a_file_that_is_too_large_is_not_read_and_said(folder):
    path = os.path.join(folder, CACHE)
    with open(path, "r+b") as file:
        file.truncate(1 << 40)
    again = "all recordings are read again"
    assert load_rows(folder, "1") == ({}, f"{path} can't be read (it has 1,099,511.6 MB, more than 64 MB): {again}")
    os.unlink(path)
    os.mkfifo(path)
    assert load_rows(folder, "1") == ({}, f"{path} can't be read (it is a pipe): {again}")
    os.unlink(path)
    os.mkdir(path)
    assert load_rows(folder, "1") == ({}, f"{path} can't be read (Is a directory): {again}")


def test_file_of_a_folder_that_can_not_be_written_is_in_the_users_cache_or_it_is_said(tmp_path, elsewhere, monkeypatch):
    folder, write = str(tmp_path / "read_only"), drives.replace

    def replace(path, data, keeps_old):
        if path.startswith(folder):
            raise PermissionError(13, "Permission denied")
        return write(path, data, keeps_old)
    monkeypatch.setattr(drives, "replace", replace)
    assert save_rows(folder, "1", {"a.bag": (STATE, ROW)}) == "" and len(list(elsewhere.iterdir())) == 1
    assert list(load_rows(folder, "1")[0]) == ["a.bag"] and load_rows(str(tmp_path), "1") == ({}, "")
    def replace(path, data, keeps_old):
        raise PermissionError(13, "Permission denied")
    monkeypatch.setattr(drives, "replace", replace)
    assert save_rows(str(tmp_path), "1", {}) == f"{tmp_path / CACHE}: Permission denied"


def make(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


@pytest.mark.parametrize("files, found", [
    ("b.bag a/c.bag killed.bag.active one.mcap old.db3 notes.txt b.html c.bag.orig .trash/a.bag",
     "a/c.bag b.bag killed.bag.active old.db3 one.mcap"),
    ("drive/metadata.yaml drive/drive_0.db3 drive/drive_1.db3 drive/more/x.bag other/metadata.yaml other/a.bag",
     "drive other/a.bag"),
    ("a.bag a.orig.bag b.bag.active b.bag.orig.active c.orig.bag d/a.orig.bag",
     "a.bag b.bag.active c.orig.bag d/a.orig.bag"),
], ids=["every_kind_in_order_and_nothing_else", "a_folder_of_ros_2_is_one", "not_what_rosbag_has_repaired"])
def test_recordings_are_found(tmp_path, files, found):
    make(tmp_path, *files.split())
    assert find_recordings(str(tmp_path)) == found.split()


def test_folder_that_is_not_there_is_an_error_with_its_name(tmp_path):
    with pytest.raises(OSError) as caught:
        find_recordings(str(tmp_path / "none"))
    assert caught.value.filename == str(tmp_path / "none")


def test_fingerprint_is_the_size_and_the_newest_time_of_a_file_or_of_all_files_of_a_folder(tmp_path):
    make(tmp_path, "drive/metadata.yaml", "drive/drive_0.db3")
    for number, name in enumerate(("metadata.yaml", "drive_0.db3"), 1):
        os.utime(str(tmp_path / "drive" / name), ns=(0, number * 1000))
    assert fingerprint(str(tmp_path / "drive")) == [2, 2000]
    assert fingerprint(str(tmp_path / "drive" / "metadata.yaml")) == [1, 1000]
