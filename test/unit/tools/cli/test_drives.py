"""The command drives: what is read, what is kept, and what is said."""
import csv
import json
import os
import shutil
from pathlib import Path

import pytest

from browser import Browser, find_browser
from car_interface.common import causes
from car_interface.common.black_box_folder import store
from car_interface.tools.cli import drives
from car_interface.tools.cli.main import main
from written_recordings import drive, odometry, write_ros1, write_ros2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a bag of each kind and one that is none."""
    folder = tmp_path_factory.mktemp("made") / "drives"
    (folder / "day").mkdir(parents=True)
    write_ros1(folder / "drive.bag", drive(6.0))
    write_ros2(folder / "day" / "ros2", [message for message in drive(6.0) if message.topic != "/rosout"],
               with_definitions=False)
    (folder / "day" / "broken.bag").write_bytes(b"no bag")
    return folder


@pytest.fixture(autouse=True)
def black_box(tmp_path, monkeypatch):
    """The black box's folder of a user who has none yet."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "ros"))
    return tmp_path / "ros" / "car_interface" / "black_box"


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(str(made), str(tmp_path / "drives"))


@pytest.fixture
def read(monkeypatch):
    """The recordings that are read, by their names; no trends are drawn meanwhile."""
    monkeypatch.setattr(drives, "trends", lambda rows: "")
    names, summarize = [], drives.summarize
    monkeypatch.setattr(drives, "summarize", lambda path, *more, **topics: (
        names.append(os.path.basename(path)), summarize(path, *more, **topics))[1])
    return names


def run(folder, *options):
    return main("drives", [folder, "--jobs", "1", *options])


def lines(folder, name="drives.csv"):
    with open(os.path.join(folder, name), encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_table_has_a_row_for_each_recording_of_whatever_kind(folder, capsys):
    assert run(folder) == 0
    shown = capsys.readouterr()
    assert shown.out == (f"{folder}: 3 recordings, 3 read now, 0 read before; 1 can't be read\n"
                         f"written: {folder}/drives.html, {folder}/drives.csv\n")
    assert shown.err == "drives: day/broken.bag can't be read as a recording: it is no bag\n"
    ros2, ros1, broken = lines(folder)
    assert [row["recording"] for row in (ros2, ros1, broken)] == ["day/ros2", "drive.bag", "day/broken.bag"]
    assert ros1["distance_km"] == ros2["distance_km"] and float(ros1["distance_km"]) == pytest.approx(0.0015, abs=1e-4)
    assert broken["error"] == "day/broken.bag can't be read as a recording: it is no bag"
    with open(os.path.join(folder, "drives.html"), encoding="utf-8") as file:
        page = file.read()
    assert page.endswith("</html>\n") and 'data-plot="trends"' in page and "day/ros2" in page


def test_recording_leads_to_the_page_that_bag_report_has_written_about_it(folder, read):
    reported = Path(folder, "day", "ros2.html")
    reported.touch()
    Path(folder, "pages").mkdir()
    for output, href in (("drives.html", "day/ros2.html"), ("pages/all.html", "../day/ros2.html")):
        assert run(folder, "-o", f"{folder}/{output}") == 0
        page = Path(folder, output).read_text(encoding="utf-8")
        assert f'<a href="{href}">day/ros2</a>' in page and "drive.bag</a>" not in page
        assert "bag_report makes the pages of the others" in " ".join(page.split())


@pytest.mark.once
def test_second_run_reads_only_what_is_new_or_has_changed(folder, read, capsys):
    assert run(folder) == 0
    first = lines(folder)
    assert sorted(read) == ["broken.bag", "drive.bag", "ros2"]
    read.clear()
    assert run(folder) == 0
    assert read == ["broken.bag"] and lines(folder) == first
    assert capsys.readouterr().out.split("\n")[-3] == (
        f"{folder}: 3 recordings, 1 read now, 2 read before; 1 can't be read")
    read.clear()
    os.utime(os.path.join(folder, "drive.bag"), ns=(0, 1))
    shutil.copy(os.path.join(folder, "drive.bag"), os.path.join(folder, "new.bag"))
    os.unlink(os.path.join(folder, "day", "broken.bag"))
    assert run(folder) == 0
    assert sorted(read) == ["drive.bag", "new.bag"] and len(lines(folder)) == 3
    for options in (["--fresh"], ["--map", "/odom=odom"]):
        read.clear()
        assert run(folder, *options) == 0 and len(read) == 3
    shutil.rmtree(os.path.join(folder, "day"))
    assert run(folder) == 0
    kept = json.loads(Path(folder, drives.CACHE).read_text(encoding="ascii").split("\n")[1])["rows"]
    assert sorted(kept) == ["drive.bag", "new.bag"]


@pytest.mark.once
def test_what_was_read_before_an_interruption_is_kept(folder, read, monkeypatch):
    def interrupted(drive, path):
        if path == "drive.bag":
            raise KeyboardInterrupt
        return row(drive, path)
    row = drives.row
    monkeypatch.setattr(drives, "row", interrupted)
    assert run(folder) == 130
    monkeypatch.setattr(drives, "row", row)
    read.clear()
    assert run(folder) == 0 and sorted(read) == ["broken.bag", "drive.bag"]


def test_recording_that_breaks_the_table_becomes_a_row(folder, monkeypatch):
    monkeypatch.setattr(drives, "row", lambda drive, path: {}[path])
    assert run(folder) == 1
    assert {row["error"] for row in lines(folder)} == {
        "drive.bag: no row can be made of it (KeyError: 'drive.bag')",
        "day/ros2: no row can be made of it (KeyError: 'day/ros2')",
        "day/broken.bag can't be read as a recording: it is no bag"}


def test_folder_in_which_nothing_can_be_read_fails_and_the_terminal_says_why(tmp_path, capsys):
    for name in "abcdefg":
        write_ros1(tmp_path / f"{name}.bag", [odometry(0.0)])
    assert run(str(tmp_path), "--map", "/typo=odom") == 1
    shown = capsys.readouterr()
    assert shown.err.split("\n")[0] == "drives: a.bag has no topic /typo; it has /odom"
    assert shown.err.split("\n")[5:] == ["drives: and 2 more that can't be read: the page says why", ""]
    assert "7 can't be read" in shown.out


def test_folder_without_recordings_is_refused_in_one_line(tmp_path, capsys):
    for folder, words in ((tmp_path / "x", "is no folder: name the one with the recordings"),
                          (tmp_path, "has no recording: no .bag, no .mcap, no .db3, here or below")):
        assert run(str(folder)) == 1
        shown = capsys.readouterr().err
        assert shown.startswith(f"drives: {folder} {words}") and shown.count("\n") == 1


def test_page_goes_where_it_is_wanted_with_the_csv_beside_it_and_never_over_a_recording(
        folder, read, tmp_path, capsys, monkeypatch):
    shutil.copy(os.path.join(folder, "drive.bag"), os.fsencode(folder) + b"/\xff.bag")
    assert run(folder, "-o", str(tmp_path / "all.html")) == 0
    assert "?.bag" in [row["recording"] for row in lines(str(tmp_path), "all.csv")], "a name that is no UTF-8"
    assert not os.path.exists(os.path.join(folder, "drives.html"))
    monkeypatch.chdir(folder)
    assert run(".") == 0
    assert capsys.readouterr().out.endswith("written: ./drives.html, ./drives.csv\n")
    assert f"<h1>Drives in {folder}</h1>" in Path("drives.html").read_text(encoding="utf-8")
    for output, words in (("drive.bag", "is an input"), (
            "all.csv", "'all.csv'; accepted: the page's name, as in drives.html: the CSV lies beside it")):
        assert run(folder, "-o", output) == 1
        assert words in capsys.readouterr().err


@pytest.mark.browser
@pytest.mark.skipif(find_browser() is None, reason="no Chromium on this computer")
def test_page_in_chromium_has_no_errors_loads_nothing_fits_a_wide_window_and_can_be_read_on_a_phone(folder):
    assert run(folder) == 0
    page = Path(folder) / "drives.html"
    too_wide = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    with Browser(find_browser(), width=1280) as browser:
        browser.open(page)
        rows = browser.evaluate("document.querySelectorAll('#drives tr').length")
        hidden = browser.evaluate("(scroll => scroll.scrollWidth - scroll.clientWidth)"
                                  "(document.querySelector('#drives .scroll'))")
        height = browser.evaluate("document.querySelector('svg[data-plot=trends]').getBoundingClientRect().height")
        assert browser.evaluate(too_wide) == 0
    assert browser.complaints == [] and browser.requests == [page.resolve().as_uri()]
    assert rows == 3 and hidden == 0 and height > 300
    with Browser(find_browser(), width=500) as browser:
        browser.open(page)
        plot = browser.evaluate("document.querySelector('svg[data-plot=trends]').getBoundingClientRect().width")
        assert plot >= 640 and browser.evaluate(too_wide) == 0


@pytest.mark.once
def test_terminal_names_the_newest_recording_of_the_black_box(folder, read, black_box, capsys):
    path = store(str(black_box), "2026-11-25_22-17-24", causes.ODOMETRY_STALE, b"a bag")
    assert run(folder) == 0
    assert capsys.readouterr().out.split("\n")[-2] == (
        f"the last stop that nobody asked for: odometry silent, just now: rosrun car_interface bag_report {path}")
