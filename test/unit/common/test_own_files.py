"""In a folder that everybody can write to nothing but this user's own files is used."""
import errno
import multiprocessing
import os
import shutil
import socket
import stat
import tempfile

import pytest

from car_interface.common.own_files import UnsafeFile, check_folder, check_socket, folder_name, make_folder, open_own

NOBODY = 65534
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="only root can be two users")


@pytest.fixture
def shared():
    """A folder like /tmp."""
    path = tempfile.mkdtemp()
    os.chmod(path, 0o1777)
    yield path
    shutil.rmtree(path)


@pytest.fixture
def own(shared):
    return os.path.join(shared, folder_name())


def as_nobody(act, *arguments):
    """Have another user do something, in a process of his own."""
    process = multiprocessing.get_context("spawn").Process(target=become_nobody, args=(act, *arguments))
    process.start()
    process.join()
    assert process.exitcode == 0


def become_nobody(act, *arguments):
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    os.umask(0)
    act(*arguments)


def make_socket_and_file(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
    with open(f"{path}.lock", "wb"):
        pass


def test_folder_is_made_for_its_user_alone_and_is_taken_again(own):
    with pytest.raises(FileNotFoundError):
        check_folder(own)
    make_folder(own)
    assert stat.S_IMODE(os.stat(own).st_mode) == 0o700
    make_folder(own)
    check_folder(own)


@needs_root
def test_folder_of_another_user_is_refused_with_cause_and_remedy(own):
    as_nobody(os.mkdir, own)
    with pytest.raises(UnsafeFile) as refused:
        make_folder(own)
    assert str(refused.value) == (
        f"{own} is another user's: nobody's. Have it removed (sudo rm -r {own}), or give the variable TMPDIR a folder "
        "of your own, for all of the car's nodes")
    assert refused.value.errno == errno.EACCES and os.listdir(own) == []


@needs_root
def test_link_of_another_user_to_this_users_own_folder_is_refused_and_nothing_is_made_there(own, tmp_path):
    as_nobody(os.symlink, str(tmp_path), own)
    for use in (make_folder, lambda folder: check_socket(f"{folder}/chip"),
                lambda folder: open_own(f"{folder}/chip.lock", os.O_RDWR | os.O_CREAT)):
        with pytest.raises(UnsafeFile, match="is a link, of nobody"):
            use(own)
    assert os.listdir(tmp_path) == []


@needs_root
def test_socket_and_file_of_another_user_are_refused(shared):
    as_nobody(make_socket_and_file, f"{shared}/chip")
    with pytest.raises(UnsafeFile, match=f"{shared}/chip is another user's: nobody's. See what it is"):
        check_socket(f"{shared}/chip")
    with pytest.raises(UnsafeFile, match=f"{shared}/chip.lock is another user's: nobody's"):
        open_own(f"{shared}/chip.lock", os.O_RDWR | os.O_CREAT)


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701])
def test_folder_that_is_open_to_others_is_refused(own, mode):
    make_folder(own)
    os.chmod(own, mode)
    with pytest.raises(UnsafeFile, match=rf"open to other users \(mode {mode:o}\). If all in it is yours: chmod 700"):
        make_folder(own)


def test_file_in_place_of_the_folder_and_a_folder_that_all_can_replace_are_refused(own, shared):
    with open(own, "w", encoding="ascii"):
        pass
    with pytest.raises(UnsafeFile, match="is no folder"):
        make_folder(own)
    os.unlink(own)
    make_folder(own)
    os.chmod(shared, 0o777)
    with pytest.raises(UnsafeFile, match=rf"{shared} lets every user replace what is in it. Set its sticky bit"):
        check_folder(own)


def test_folder_of_another_name_is_its_owners_choice(tmp_path):
    make_folder(str(tmp_path / "a" / "b"))
    os.chmod(tmp_path, 0o755)
    check_folder(str(tmp_path))


def test_file_is_made_for_its_user_alone_or_with_the_mode_that_is_wanted(tmp_path):
    for name, more, mode in (("lock", (), 0o600), ("log", (0o644,), 0o644)):
        os.close(open_own(str(tmp_path / name), os.O_WRONLY | os.O_CREAT, *more))
        assert stat.S_IMODE(os.stat(tmp_path / name).st_mode) == mode
    with pytest.raises(FileNotFoundError):
        open_own(str(tmp_path / "absent" / "lock"), os.O_RDWR | os.O_CREAT)


@pytest.mark.parametrize("make, cause", [
    (lambda path: os.symlink(f"{path}.made", path), "is a link"),
    (os.mkdir, r"can't be opened \(Is a directory\)"),
    (os.mkfifo, "is no regular file"),
    (lambda path: (os.mknod(path), os.chmod(path, 0o644)), r"is open to other users \(mode 644\)"),
], ids=["link", "folder", "pipe", "open_to_others"])
def test_what_is_no_file_of_its_own_is_not_opened(tmp_path, make, cause):
    path = str(tmp_path / "lock")
    make(path)
    files = os.listdir("/proc/self/fd")
    with pytest.raises(UnsafeFile, match=f"lock {cause}. See what it is"):
        open_own(path, os.O_RDWR | os.O_CREAT)
    assert os.listdir(tmp_path) == ["lock"] and os.listdir("/proc/self/fd") == files
