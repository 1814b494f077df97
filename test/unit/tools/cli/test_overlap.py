"""Recordings with the same driving in them are refused; others aren't, whatever their clocks."""
import pytest

from car_interface.tools.cli.jobs import check_no_overlap, check_paths_differ
from car_interface.tools.recordings.recording import NoRecording
from car_interface.tools.recordings.signals import load, trail
from written_recordings import odometry, write_ros1


def driving(path, begin, end, towards=1.0):
    rows = [odometry(0.1 * index, x_m=towards * index, speed_mps=10.0) for index in range(begin, end)]
    return load(str(write_ros1(path, rows)), ["odom"])


def test_recording_under_another_name_is_the_same(tmp_path):
    path, link = tmp_path / "a.bag", tmp_path / "b.bag"
    path.touch()
    link.symlink_to(path)
    for again in (path, link):
        with pytest.raises(NoRecording, match=rf"{path} and {again} are the same recording: it would count twice"):
            check_paths_differ([str(path), str(again)])
    check_paths_differ([str(path), str(tmp_path / "c.bag")])


@pytest.mark.parametrize("begin, end", [(0, 200), (140, 300)], ids=["copy", "overlapping_part"])
def test_recording_with_driving_that_another_has_is_refused_by_both_names(tmp_path, begin, end):
    one, other = driving(tmp_path / "a.bag", 0, 200), driving(tmp_path / "b.bag", begin, end)
    with pytest.raises(NoRecording, match=r"a\.bag and .*b\.bag have the same driving in them"):
        check_no_overlap([trail(one), trail(other)])


def test_clock_that_begins_at_the_same_time_again_makes_no_driving_the_same(tmp_path):
    one, other = driving(tmp_path / "a.bag", 0, 200), driving(tmp_path / "b.bag", 0, 200, towards=-1.0)
    standing = load(str(write_ros1(tmp_path / "c.bag", [odometry(0.1 * index) for index in range(200)])), ["odom"])
    check_no_overlap([trail(found) for found in (one, other, standing, standing)])
