"""Which recordings are in a folder, and when one counts as changed."""
from __future__ import annotations

import os

import pytest

from car_interface.tools.recordings.folder import Fingerprint, find_recordings, fingerprint


def make(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")


def test_recordings_of_every_kind_are_found_in_order_and_nothing_else(tmp_path):
    make(tmp_path, "b.bag", "a/c.bag", "killed.bag.active", "one.mcap", "old.db3", "notes.txt", "b.html", "c.bag.orig",
         ".trash/a.bag")
    assert find_recordings(str(tmp_path)) == ["a/c.bag", "b.bag", "killed.bag.active", "old.db3", "one.mcap"]


def test_folder_of_ros_2_is_one_recording_and_not_its_files(tmp_path):
    make(tmp_path, "drive/metadata.yaml", "drive/drive_0.db3", "drive/drive_1.db3", "drive/more/x.bag",
         "other/metadata.yaml", "other/a.bag")
    assert find_recordings(str(tmp_path)) == ["drive", "other/a.bag"]


def test_damaged_recording_that_rosbag_has_repaired_is_left_out_but_not_one_of_such_a_name_alone(tmp_path):
    make(tmp_path, "a.bag", "a.orig.bag", "b.bag.active", "b.bag.orig.active", "c.orig.bag", "d/a.orig.bag")
    assert find_recordings(str(tmp_path)) == ["a.bag", "b.bag.active", "c.orig.bag", "d/a.orig.bag"]


def test_folder_that_is_not_there_is_an_error_with_its_name(tmp_path):
    with pytest.raises(OSError) as caught:
        find_recordings(str(tmp_path / "none"))
    assert caught.value.filename == str(tmp_path / "none")


def test_fingerprint_changes_with_size_or_time(tmp_path):
    path = tmp_path / "a.bag"
    path.write_bytes(b"1234")
    os.utime(str(path), ns=(5, 7_000))
    assert fingerprint(str(path)) == Fingerprint(4, 7_000)
    os.utime(str(path), ns=(5, 8_000))
    assert fingerprint(str(path)) == Fingerprint(4, 8_000)


def test_fingerprint_of_a_folder_is_that_of_all_its_files(tmp_path):
    make(tmp_path, "drive/metadata.yaml", "drive/drive_0.db3")
    for number, name in enumerate(("metadata.yaml", "drive_0.db3"), 1):
        os.utime(str(tmp_path / "drive" / name), ns=(0, number * 1000))
    assert fingerprint(str(tmp_path / "drive")) == Fingerprint(2, 2000)
