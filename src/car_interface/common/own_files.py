"""Uses files in folders that others can write to, such as /tmp: never another user's file, never by a link.

Everybody knows such a path, and whoever is first could put a socket, a file or a link there.
"""
from __future__ import annotations

import errno
import os
import pwd
import stat

FOLDER_MODE, FILE_MODE = 0o700, 0o600
OTHERS_BITS = 0o077
# The kernel's errors where a link, a pipe, a folder or another user's file is at the path.
REFUSALS = (errno.ELOOP, errno.ENXIO, errno.EISDIR, errno.EACCES, errno.EPERM)


class UnsafeFile(PermissionError):
    """Something that another user has made, or can change, where this user's own is expected.

    Args:
        cause: what is wrong with it, as the end of a sentence.
        remedy: what the user can do; empty = to look, and remove it.
    """

    def __init__(self, path: str, cause: str, remedy: str = ""):
        super().__init__(errno.EACCES, f"it {cause}", path)
        self.cause = f"{path} {cause}"
        self.remedy = remedy or f"See what it is (ls -l {path}) and remove it, or choose another path"

    def __str__(self):
        return f"{self.cause}. {self.remedy}"


def folder_name() -> str:
    """Return the name of this user's folder in a place that all users share, such as /tmp."""
    return f"car_interface-{os.getuid()}"


def make_folder(folder: str) -> None:
    """Make the folder unless it is there, and check it.

    Raises:
        UnsafeFile: see ``check_folder``.
        OSError: it can't be made.
    """
    try:
        os.makedirs(folder, FOLDER_MODE, exist_ok=True)
    except FileExistsError:  # something else is there
        check_folder(folder)
        raise
    check_folder(folder)


def check_folder(folder: str) -> None:
    """Check this user's folder in a place that all users share. In any other folder its files are checked alone.

    Raises:
        UnsafeFile: it is another user's, a link, open to other users, or they could replace it.
        FileNotFoundError: there is none.
    """
    if os.path.basename(folder) != folder_name():
        return
    status, parent = os.lstat(folder), os.path.dirname(folder)
    remedy = (f"Have it removed (sudo rm -r {folder}), or give the variable TMPDIR a folder of your own, for all of "
              "the car's nodes")
    if stat.S_ISLNK(status.st_mode):
        raise UnsafeFile(folder, f"is a link, of {_name(status.st_uid)}", remedy)
    if not stat.S_ISDIR(status.st_mode):
        raise UnsafeFile(folder, f"is no folder, and {_name(status.st_uid)}'s", remedy)
    if status.st_uid != os.geteuid():
        raise UnsafeFile(folder, f"is another user's: {_name(status.st_uid)}'s", remedy)
    if status.st_mode & OTHERS_BITS:
        raise UnsafeFile(folder, f"is open to other users (mode {stat.S_IMODE(status.st_mode):o})",
                         f"If all in it is yours: chmod 700 {folder}; else remove it")
    mode = os.stat(parent).st_mode
    if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
        raise UnsafeFile(parent, "lets every user replace what is in it",
                         f"Set its sticky bit (sudo chmod +t {parent}), or give TMPDIR a folder of your own")


def check_socket(path: str) -> None:
    """Check a socket before it is connected to or removed.

    Raises:
        UnsafeFile: something else is there, or another user's socket.
        FileNotFoundError: there is nothing.
    """
    check_folder(os.path.dirname(path))
    status = os.lstat(path)
    if not stat.S_ISSOCK(status.st_mode):
        raise UnsafeFile(path, "is no socket")
    check_owner(status.st_uid, path)


def check_owner(user: int, path: str) -> None:
    """Check that the file at a path, or the process that listens there, is this user's.

    Raises:
        UnsafeFile: it is another one's.
    """
    if user != os.geteuid():
        raise UnsafeFile(path, f"is another user's: {_name(user)}'s")


def open_own(path: str, flags: int, mode: int = FILE_MODE) -> int:
    """Open a regular file of this user's, and no link to one; return a descriptor that children don't inherit.

    Args:
        flags: as ``os.open``; with O_CREAT it is made if there is none.
        mode: of a file that is made. Where this is FILE_MODE one that is open to others is refused, too.

    Raises:
        UnsafeFile: something else is there, or another user's file.
        OSError: it can't be opened.
    """
    check_folder(os.path.dirname(path))
    try:
        # Opening a pipe in its place would wait without O_NONBLOCK, which has no effect on a regular file.
        handle = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, mode)
    except OSError as error:
        if error.errno not in REFUSALS or not os.path.lexists(path):
            raise
        cause = "is a link" if error.errno == errno.ELOOP else f"can't be opened ({error.strerror})"
        raise UnsafeFile(path, cause) from error
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise UnsafeFile(path, "is no regular file")
        check_owner(status.st_uid, path)
        if mode == FILE_MODE and status.st_mode & OTHERS_BITS:
            raise UnsafeFile(path, f"is open to other users (mode {stat.S_IMODE(status.st_mode):o})")
    except OSError:
        os.close(handle)
        raise
    return handle


def _name(user):
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return f"user {user}"
