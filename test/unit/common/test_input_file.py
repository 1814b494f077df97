"""Files that people write: what is refused before it is read, and which texts are numbers."""
import os
import socket

import pytest

from car_interface.common.input_file import finite_number, integer, read_file


def test_file_is_read_and_a_link_to_it_too(tmp_path):
    (tmp_path / "a").write_bytes(b"content")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    assert read_file(str(tmp_path / "a"), 7) == read_file(str(tmp_path / "link"), 7) == b"content"


def pipe(path):
    os.mkfifo(str(path))
    return path


def listening(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))
    return path


def sparse(path):
    with open(str(path), "wb") as file:
        file.truncate(1_000_000_000)
    return path


@pytest.mark.parametrize("make, reason", [
    (pipe, "it is a pipe"),
    (lambda path: "/dev/zero", "it is a device"),
    (listening, "it is a socket"),
    (lambda path: path.parent, "Is a directory"),
    (sparse, "it has 1,000.0 MB, more than 2 MB"),
    (lambda path: path, "No such file or directory"),
])
def test_what_is_no_file_of_a_person_is_refused_by_its_kind_or_size(tmp_path, make, reason):
    with pytest.raises(OSError) as caught:
        read_file(str(make(tmp_path / "a")), 2_000_000)
    assert caught.value.strerror == reason


def test_file_that_is_longer_than_its_size_is_read_up_to_the_limit_only(tmp_path):
    assert os.stat("/proc/self/status").st_size == 0
    assert read_file("/proc/self/status", 1_000_000).startswith(b"Name:")
    with pytest.raises(OSError, match="it has no end in sight, more than 1e-05 MB"):
        read_file("/proc/self/status", 10)


def test_file_that_became_a_pipe_before_it_was_opened_is_refused(tmp_path, monkeypatch):
    path, before = pipe(tmp_path / "a"), os.stat(__file__)
    monkeypatch.setattr("car_interface.common.input_file.os.stat", lambda _: before)
    with pytest.raises(OSError, match="it is a pipe"):
        read_file(str(path), 10)


@pytest.mark.parametrize("text, number", [
    ("12", 12.0), ("-0.5", -0.5), (" 1e-3 ", 1e-3), ("+.5E2", 50.0), ("3.", 3.0),
    ("1_0", None), ("١٢", None), ("७", None), ("1e999", None), ("nan", None), ("inf", None), ("-Infinity", None),
    ("0x10", None), ("1,5", None), ("−1", None), ("", None), ("1 2", None),
])
def test_number_is_ascii_and_finite(text, number):
    assert finite_number(text) == number


@pytest.mark.parametrize("text, number", [
    ("12", 12), ("-5", -5), ("0x40", 64), ("0b1", 1), ("1_0", None), ("0x4_0", None), ("١٢", None), ("1.0", None),
    ("010", None), ("", None),
])
def test_integer_is_ascii(text, number):
    assert integer(text) == number
