"""The command bag_report: where pages go, what is refused, and a page in a real browser."""
import contextlib
import io
import pathlib
import shutil

import pytest
from matplotlib import image

from browser import Browser, find_browser
from car_interface.tools.cli import bag_report
from car_interface.tools.cli.main import main
from written_recordings import drive, odometry, write_ros1

PLOTS = ["who", "steering", "path", "speed", "link"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return str(write_ros1(tmp_path_factory.mktemp("bags") / "drive.bag", drive(25.0)))


@pytest.fixture(scope="module")
def page(bag, tmp_path_factory):
    """The page of the drive with all of its plots, and what the command wrote to the terminal."""
    out = tmp_path_factory.mktemp("pages") / "out.html"
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        assert main("bag_report", [bag, "-o", str(out)]) == 0
    return out, shown.getvalue()


def test_command_writes_the_page_and_says_where(page):
    out, shown = page
    assert shown == f"{out}\n" and out.read_text(encoding="utf-8").endswith("</html>\n")
    assert out.stat().st_mode & 0o077 == 0o044


@pytest.fixture
def no_plots(monkeypatch):
    """Pages without plots, each of which takes a second."""
    monkeypatch.setattr(bag_report, "plots", lambda seen: {})


@pytest.mark.parametrize("arguments, words", [
    (["a.bag", "b.bag", "-o", "nowhere"], "is no folder, and 2 recordings need one"),
    (["a/x.bag", "b/x.bag", "-o", "."], "would both get the page x.html"),
    (["a.bag"], "a.bag can't be read as a recording: there is no such file"),
    (["a.bag", "-o", "none/a.html"], "there is no folder"),
    (["a.bag", "--map", "/ekf=wheels"], "--map is '/ekf=wheels'; accepted: TOPIC=ROLE with a role of odom, imu, out"),
], ids=["no_folder", "same_name", "missing", "no_folder_for_the_page", "no_such_role"])
def test_what_can_not_be_done_is_refused_in_one_line(arguments, words, capsys):
    assert main("bag_report", arguments) == 1
    shown = capsys.readouterr()
    assert words in shown.err and shown.err.count("\n") == 1


def test_page_replaces_an_old_one_but_never_a_recording(bag, no_plots, tmp_path, capsys):
    old, recording = tmp_path / "old.html", pathlib.Path(bag).read_bytes()
    old.write_text("old")
    assert main("bag_report", [bag, "-o", str(old)]) == 0
    assert old.read_text().endswith("</html>\n") and [path.name for path in tmp_path.iterdir()] == ["old.html"]
    capsys.readouterr()
    assert main("bag_report", [bag, "-o", bag]) == 1
    assert capsys.readouterr().err.startswith(f"bag_report: {bag} is an input")
    assert pathlib.Path(bag).read_bytes() == recording


def test_recording_that_is_none_or_breaks_the_report_stops_no_other(bag, tmp_path, capsys, monkeypatch):
    bad, other = tmp_path / "bad.bag", shutil.copy(bag, str(tmp_path / "other.bag"))
    bad.write_bytes(b"no bag")
    monkeypatch.setattr(bag_report, "plots", lambda seen: {bag: {}}[seen.path])
    assert main("bag_report", [str(bad), other, bag, "-o", str(tmp_path), "--jobs", "1"]) == 1
    shown = capsys.readouterr()
    assert shown.out == f"{tmp_path / 'drive.html'}\n"
    assert shown.err == (f"bag_report: {bad} can't be read as a recording: it is no bag\n"
                         f"bag_report: {other}: no page can be made of it (KeyError: {other!r})\n")


@pytest.mark.once
def test_pages_are_made_in_processes_too(tmp_path, capsys):
    bad, bag = tmp_path / "bad.bag", write_ros1(tmp_path / "drive.bag", [odometry(0.0)])
    bad.write_bytes(b"no bag")
    assert main("bag_report", [str(bad), str(bag), "-o", str(tmp_path), "--jobs", "2"]) == 1
    shown = capsys.readouterr()
    assert shown.out == f"{tmp_path / 'drive.html'}\n" and shown.err.startswith(f"bag_report: {bad} can't be read")


def test_page_of_a_car_below_a_namespace_has_that_in_its_name(no_plots, tmp_path, capsys):
    path = write_ros1(tmp_path / "drive.bag", drive(10.0, "/car1"))
    for option in ("--ns", "--namespace"):
        assert main("bag_report", [str(path), option, "/car1/"]) == 0
        assert capsys.readouterr().out == f"{tmp_path / 'drive.car1.html'}\n"


def test_guess_and_what_the_user_says_are_told_beside_the_page(no_plots, tmp_path, capsys):
    messages = [message._replace(topic="/ekf") for message in drive(10.0) if message.topic == "/odom"]
    path, out = str(write_ros1(tmp_path / "a.bag", messages)), str(tmp_path / "a.html")
    for options, note in (([], "odom: /ekf (the only nav_msgs/Odometry)"),
                          (["--map", "/ekf=odom"], "odom: /ekf (as you say)")):
        assert main("bag_report", [path, *options]) == 0
        shown = capsys.readouterr()
        assert (shown.out, shown.err) == (f"{out}\n", f"bag_report: {path}: {note}\n")
        text = pathlib.Path(out).read_text(encoding="utf-8").replace("<wbr>", "")
        assert f"<tr><th>Topics</th><td>{note}</td></tr>" in text


@pytest.mark.browser
@pytest.mark.skipif(find_browser() is None, reason="no Chromium on this computer")
def test_page_in_chromium_shows_every_plot_and_has_no_errors(page):
    out, _ = page
    with Browser(find_browser()) as browser:
        browser.open(out)
        places = browser.evaluate(
            "[...document.querySelectorAll('svg[data-plot]')].map(svg => { const box = svg.getBoundingClientRect();"
            " return [svg.dataset.plot, box.left, box.top + scrollY, box.width, box.height]; })")
        title = browser.evaluate("document.title")
        wide = browser.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        picture = image.imread(io.BytesIO(browser.picture()))
        browser.resize(390)
        is_phone_wide = browser.evaluate("document.documentElement.scrollWidth") == 390
        lines_of_names = browser.evaluate(
            "[...document.querySelectorAll('.driver, .level')].map(name => name.getClientRects().length)")
        esc_words = browser.evaluate("[...document.querySelectorAll('#throttle td:nth-child(4)')]"
                                     ".map(cell => cell.scrollWidth <= cell.clientWidth && cell.offsetHeight)")
    assert browser.complaints == [] and browser.requests == [out.resolve().as_uri()]
    assert title == "Drive: drive.bag" and wide == 0
    assert is_phone_wide and all(esc_words) and set(lines_of_names) == {1}
    assert [place[0] for place in places] == PLOTS
    for name, left, top, width, height in places:
        part = picture[round(top):round(top + height), round(left):round(left + width), :3]
        assert abs(part.shape[0] - height) < 2 and abs(part.shape[1] - width) < 2, f"{name} is cut off"
        assert width > 800 and height > 80, name
        inked = (part.min(axis=2) < 0.8).mean(axis=0)  # by column
        assert (inked > 0).mean() > 0.35, f"{name} is all but empty"
        coloured = (part.max(axis=2) - part.min(axis=2) > 0.25).mean()
        assert coloured > 0.0005, f"{name} has no curve in it"
