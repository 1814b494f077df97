"""Where results are written: what is refused, and what becomes of an old file."""
import os

import pytest

from car_interface.common import output
from car_interface.common.errors import CarInterfaceError


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
    output.write(str(link), "¼ m")
    assert link.is_symlink() and target.read_text(encoding="utf-8") == "¼ m"


def test_what_is_no_file_is_written_to_as_it_is(capfd):
    for path in ("/dev/null", "/dev/stdout"):
        output.check(path)
        assert output.write(path, "hello", keeps_old=True) is None
    assert capfd.readouterr().out == "hello"


def test_half_written_file_is_none(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_text("old")

    def full(handle):
        raise OSError(28, "No space left on device")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CarInterfaceError, match=f"{path} can't be written: No space left on device"):
        output.write(str(path), "new", keeps_old=True)
    assert [(other.name, other.read_text()) for other in tmp_path.iterdir()] == [("a", "old")]


@pytest.mark.parametrize("name, words", [
    ("", "is a folder"),
    ("new/", "is a folder"),
    ("none/a", "there is no folder"),
    ("given.bag", "is an input"),
    ("link.html", "is an input"),
    ("other.yaml", "is a recording, and would be lost"),
    ("protected.yaml", "is write-protected"),
])
def test_output_that_can_not_be_or_would_be_a_loss_is_refused_by_the_name_it_was_given(name, words, tmp_path):
    (tmp_path / "given.bag").touch()
    (tmp_path / "link.html").symlink_to(tmp_path / "given.bag")
    (tmp_path / "other.yaml").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "protected.yaml").touch(mode=0o444)
    path = f"{tmp_path}/{name}"
    with pytest.raises(CarInterfaceError, match=f"^{path} [^\n]*{words}[^\n]*$"):
        output.check(path, [str(tmp_path / "given.bag")])


def test_folder_without_permission_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: path != str(tmp_path))  # root may write everywhere
    with pytest.raises(CarInterfaceError, match=f"a can't be written: no permission in the folder {tmp_path}"):
        output.check(str(tmp_path / "a"))
