"""The black box's folder: names, the newest, and what goes when it is full."""
import os

import pytest

from car_interface.common import black_box_folder as folder_module
from car_interface.common import causes
from car_interface.common.black_box_folder import MAX_FILES, default_folder, newest, recordings, store

DATA = b"#ROSBAG V2.0"


@pytest.fixture
def folder(tmp_path):
    return str(tmp_path / "car_interface" / "black_box")


def put(folder, minute, cause=causes.ODOMETRY_STALE, data=DATA):
    """Store a recording of a minute, also by the file's time."""
    path = store(folder, f"2026-11-25_22-{minute:02}-00", cause, data)
    os.utime(path, (minute * 60, minute * 60))
    return path


@pytest.mark.parametrize("cause", sorted(causes.LOSSES))
def test_name_has_the_time_and_the_cause_and_the_cause_is_read_from_it(folder, cause):
    path = put(folder, 5, cause)
    name = os.path.basename(path)
    assert name.startswith("2026-11-25_22-05-00_") and name.endswith(".bag") and " " not in name
    assert newest(folder)[:2] == (path, cause)


def test_two_of_one_second_have_two_names(folder):
    paths = {put(folder, 5), put(folder, 5), put(folder, 5)}
    assert len(paths) == len(recordings(folder)) == 3
    assert {one.cause for one in recordings(folder)} == {causes.ODOMETRY_STALE}


def test_eleventh_removes_the_oldest(folder):
    paths = [put(folder, minute) for minute in range(MAX_FILES + 2)]
    assert [one.path for one in recordings(folder)] == paths[2:]


def test_fifty_megabytes_are_kept_and_the_newest_whatever_its_size(folder, monkeypatch):
    monkeypatch.setattr(folder_module, "MAX_BYTES", 1000)
    paths = [put(folder, minute, data=bytes(400)) for minute in range(3)]
    assert [one.path for one in recordings(folder)] == paths[1:]
    large = put(folder, 4, data=bytes(2000))
    assert [one.path for one in recordings(folder)] == [large]


def test_recording_by_a_clock_that_was_set_back_stays(folder):
    for minute in range(20, 20 + MAX_FILES):
        put(folder, minute)
    os.utime(os.path.join(folder, "2026-11-25_22-20-00_odometry_silent.bag"), (2e9, 2e9))
    path = store(folder, "1970-01-01_00-00-10", causes.JOY_STALE, DATA)
    assert path in [one.path for one in recordings(folder)]
    assert len(recordings(folder)) == MAX_FILES


def test_what_a_user_renamed_or_put_there_is_neither_counted_nor_removed(folder):
    renamed = os.path.join(folder, "crash.bag")
    os.rename(put(folder, 0), renamed)
    for minute in range(1, MAX_FILES + 3):
        put(folder, minute)
    assert os.path.exists(renamed) and len(recordings(folder)) == MAX_FILES


@pytest.mark.parametrize("age_s, text", [
    (0, "just now"), (59, "just now"), (60, "1 minute ago"), (12 * 60 + 59, "12 minutes ago"), (3600, "1 hour ago"),
    (3 * 86400 + 5, "3 days ago"), (-100, "by a clock that was set back since")])
def test_recording_describes_its_cause_and_age(folder, age_s, text):
    put(folder, 10)
    assert newest(folder).describe(600 + age_s) == f"odometry silent, {text}"


def test_folder_is_the_user_s_and_none_has_no_recording(folder, monkeypatch):
    monkeypatch.setenv("ROS_HOME", "/ros")
    assert default_folder() == "/ros/car_interface/black_box"
    monkeypatch.delenv("ROS_HOME")
    monkeypatch.setenv("HOME", "/home/me")
    assert default_folder() == "/home/me/.ros/car_interface/black_box"
    assert newest(folder) is None
    put(folder, 0)
    assert os.stat(folder).st_mode & 0o077 == 0
