"""What was read before is kept, and is used only if nothing has changed."""
from __future__ import annotations

import os

import pytest

from car_interface.cli import drives_cache
from car_interface.cli.drives_cache import NAME, Cache
from car_interface.recordings.folder import Fingerprint
from car_interface.report.drives_row import Row

STATE = Fingerprint(100, 5)
ROW = Row("a.bag", start_ns=1, duration_s=2.0, losses={"e_stop": 1}, lacks=["/rosout"], notes=[], left_ratio=1.05)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """The user's cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "car_interface"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "drives").mkdir()
    cache = Cache(str(tmp_path / "drives"), "1")
    cache.add(STATE, ROW)
    assert cache.save(["a.bag"]) == ""
    return str(tmp_path / "drives")


def test_row_comes_back_as_it_was(folder):
    assert Cache(folder, "1").row("a.bag", STATE)._asdict() == ROW._asdict()
    assert os.listdir(folder) == [NAME]


@pytest.mark.parametrize("path, state, version", [
    ("b.bag", STATE, "1"), ("a.bag", Fingerprint(101, 5), "1"), ("a.bag", Fingerprint(100, 6), "1"),
    ("a.bag", STATE, "2"), ("a.bag", None, "1"),
], ids=["another_recording", "another_size", "another_time", "another_version", "gone"])
def test_row_of_something_else_is_not_used(folder, path, state, version):
    cache = Cache(folder, version)
    assert cache.row(path, state) is None and cache.problem == ""


def test_row_with_an_error_is_not_kept_nor_one_whose_recording_is_gone(folder):
    cache = Cache(folder, "1")
    cache.add(STATE, Row("bad.bag", error="no permission"))
    cache.add(STATE, ROW._replace(path="b.bag"))
    cache.save(["bad.bag", "b.bag"])
    again = Cache(folder, "1")
    assert again.row("bad.bag", STATE) is None and again.row("a.bag", STATE) is None
    assert again.row("b.bag", STATE).path == "b.bag"


@pytest.mark.parametrize("damage", [
    pytest.param(lambda text: "", id="empty"),
    pytest.param(lambda text: text[:100], id="cut_off"),
    pytest.param(lambda text: text.replace("1.05", "9.05"), id="another_number"),
    pytest.param(lambda text: "garbage\n{}\n", id="garbage"),
    pytest.param(lambda text: text.replace("a", "ä"), id="not_ascii"),
])
def test_damaged_file_is_said_and_replaced(folder, damage):
    path = os.path.join(folder, NAME)
    with open(path, encoding="utf-8") as file:
        text = file.read()
    with open(path, "w", encoding="utf-8") as file:
        file.write(damage(text))
    cache = Cache(folder, "1")
    assert cache.problem == f"{path} is damaged" and cache.row("a.bag", STATE) is None
    cache.add(STATE, ROW)
    assert cache.save(["a.bag"]) == "" and Cache(folder, "1").row("a.bag", STATE) is not None


def test_file_that_can_not_be_read_is_said(folder):
    os.unlink(os.path.join(folder, NAME))
    os.mkdir(os.path.join(folder, NAME))
    assert Cache(folder, "1").problem == f"{os.path.join(folder, NAME)} can't be read (Is a directory)"


def test_folder_that_can_not_be_written_has_its_file_in_the_users_cache_folder(tmp_path, elsewhere, monkeypatch):
    folder, write = str(tmp_path / "read_only"), drives_cache.replace

    def replace(path, data, keeps_old):
        if path.startswith(folder):
            raise PermissionError(13, "Permission denied")
        return write(path, data, keeps_old)
    monkeypatch.setattr(drives_cache, "replace", replace)
    cache = Cache(folder, "1")
    cache.add(STATE, ROW)
    assert cache.save(["a.bag"]) == "" and len(list(elsewhere.iterdir())) == 1
    assert Cache(folder, "1").row("a.bag", STATE) is not None and Cache(str(tmp_path), "1").row("a.bag", STATE) is None


def test_what_can_not_be_kept_anywhere_is_said_with_the_folders_own_file(tmp_path, monkeypatch):
    def replace(path, data, keeps_old):
        raise PermissionError(13, "Permission denied")
    monkeypatch.setattr(drives_cache, "replace", replace)
    assert Cache(str(tmp_path), "1").save([]) == f"{tmp_path / NAME}: Permission denied"
