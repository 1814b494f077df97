"""Replaces a file in one step: a reader sees the old content or the new one, never a part of either.

A new file has no name until it is complete (O_TMPFILE), so that a killed process leaves nothing behind, with one
exception: a file is replaced by renaming another one, and a process can be killed between naming that and renaming it.
Such a leftover, or one from a file system without O_TMPFILE, is removed by the next replacement of the file. The
process that makes a new file holds a lock on it, so a file that is not locked is a leftover.
"""
from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import stat
import time
from typing import NamedTuple

WRITE_BITS = 0o222
DIGITS = 8  # of the names of files that are not in place yet: .NAME.new-1a2b3c4d
# Of open and link: this file system, or a system without /proc, has no files without a name, or no second names.
NOT_SUPPORTED = (errno.EOPNOTSUPP, errno.EISDIR, errno.EINVAL, errno.ENOENT, errno.EPERM, errno.EMLINK, errno.EXDEV,
                 errno.ENOSYS)


class _Like(NamedTuple):
    """The attributes of a new file beside its content.

    Attributes:
        mode: the permissions.
        owner: user and group; ``None`` = this process's own.
        times_ns: of last access and change; ``None`` = now.
    """

    mode: int
    owner: tuple | None = None
    times_ns: tuple | None = None


def is_write_protected(path: str) -> bool:
    """Return whether a file is write-protected. Replacing it needs
    write access to its folder only, and root may always.
    """
    return not os.access(path, os.W_OK) or not os.stat(path).st_mode & WRITE_BITS


def replace(path: str, data: bytes, keeps_old: bool) -> str | None:
    """Replace a file, with the old one's mode and, as far as that is allowed, owner.

    Args:
        path: of the file; a link is replaced itself.
        data: the new content.
        keeps_old: keep the old file in the same folder, under a name with the time.

    Returns:
        The backup's path, if there is one.

    Raises:
        OSError: nothing was changed, and nothing is left behind.
    """
    _remove_leftovers(path)
    try:
        old = os.stat(path)
    except FileNotFoundError:
        old = None
    like = _Like(0o666 & ~_umask()) if old is None else _Like(stat.S_IMODE(old.st_mode), (old.st_uid, old.st_gid))
    backup_path = None
    with _NewFile(path, data, like) as new:
        try:
            if old is not None and keeps_old:
                backup_path = _back_up(path)
            new.move(path)
        except BaseException:
            if backup_path is not None:
                os.unlink(backup_path)
            raise
    _sync_folder(path)
    return backup_path


class _NewFile:
    """A complete file that is not in place yet; on leaving the context it is removed unless it was put in place.

    Args:
        path: of the file that it replaces, or is a copy of.
        data: the content.
        like: the rest.
    """

    def __init__(self, path, data, like):
        self._path = path
        self._new_path = None  # while it has a name of its own
        self._fd = self._open()
        try:
            with open(self._fd, "wb", closefd=False) as file:
                file.write(data)
            if like.owner is not None:
                _give(self._fd, *like.owner)
            os.fchmod(self._fd, like.mode)
            if like.times_ns is not None:
                os.utime(self._fd, ns=like.times_ns)
            os.fsync(self._fd)
        except BaseException:
            self.__exit__()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            if self._new_path is not None:
                os.unlink(self._new_path)
        finally:
            os.close(self._fd)

    def move(self, path):
        """Put it in place of the file at a path."""
        if self._new_path is None:
            self._give_name()
        os.replace(self._new_path, path)
        self._new_path = None

    def add(self, path):
        """Put it at a path where nothing is.

        Raises:
            FileExistsError: something is there.
        """
        if self._new_path is None:
            _link_unnamed(self._fd, path)
            return
        try:
            os.link(self._new_path, path)
        except FileExistsError:
            raise
        except OSError as error:
            if error.errno not in NOT_SUPPORTED:
                raise
            if os.path.lexists(path):
                raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), path) from None
            self.move(path)  # without links, as on a USB stick: nobody else makes a backup within the same moment

    def _open(self):
        fd = _open_unnamed(os.path.dirname(self._path))
        while fd is None:
            new_path = _new_path(self._path)
            fd = os.open(new_path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            if _is_kept(fd):
                self._new_path = new_path
            else:
                os.close(fd)
                fd = None
        return fd

    def _give_name(self):
        new_path = _new_path(self._path)
        _link_unnamed(self._fd, new_path)
        self._new_path = new_path


def _open_unnamed(folder):
    """Open a file without a name in a folder and lock it; ``None`` where the file system has no such files."""
    if not hasattr(os, "O_TMPFILE") or not os.path.exists("/proc/self/fd"):
        return None
    try:
        fd = os.open(folder or ".", os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if error.errno in NOT_SUPPORTED:
            return None
        raise
    _is_kept(fd)
    return fd


def _link_unnamed(fd, path):
    # With a folder's descriptor, even one that an absolute path has no use for, Python calls linkat, which follows.
    os.link(f"/proc/self/fd/{fd}", os.path.abspath(path), src_dir_fd=fd)


def _new_path(path):
    folder, name = os.path.split(path)
    return os.path.join(folder, f".{name}.new-{secrets.token_hex(DIGITS // 2)}")


def _remove_leftovers(path):
    """Remove what killed processes left behind when they replaced this file."""
    folder, name = os.path.split(path)
    is_new = re.compile(rf"\.{re.escape(name)}\.new-[0-9a-f]{{{DIGITS}}}").fullmatch
    try:
        found = list(filter(is_new, os.listdir(folder or ".")))
    except OSError:  # it may be written, but not listed
        return
    for other in found:
        left_path = os.path.join(folder, other)
        try:
            # For writing, too: network drives lock nothing else.
            fd = os.open(left_path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError:  # gone, or somebody else's
            continue
        try:
            if _lock(fd):
                os.unlink(left_path)
        except OSError:
            pass
        finally:
            os.close(fd)


def _lock(fd):
    """Lock a file until its descriptor is closed; return False if somebody else has locked it."""
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_kept(fd):
    """Lock a new file; return False if another process took it for a leftover before it was locked."""
    try:
        return _lock(fd) and os.fstat(fd).st_nlink > 0
    except OSError:  # without locks here, nobody can take it for left over
        return True


def _give(fd, user, group):
    try:
        os.fchown(fd, user, group)
    except PermissionError:
        pass  # only root may give files away


def _back_up(path):
    """Copy the file to a name with the time, and return that; an existing file is never overwritten."""
    stem = f"{path}.bak-{time.strftime('%Y%m%d-%H%M%S')}"
    with open(path, "rb") as file:
        old = os.fstat(file.fileno())
        data = file.read()
    like = _Like(stat.S_IMODE(old.st_mode), (old.st_uid, old.st_gid), (old.st_atime_ns, old.st_mtime_ns))
    with _NewFile(path, data, like) as backup:
        for attempt in range(1, 1000):
            backup_path = stem if attempt == 1 else f"{stem}-{attempt}"
            try:
                backup.add(backup_path)
                return backup_path
            except FileExistsError:
                continue
    raise FileExistsError(errno.EEXIST, f"too many files named {stem}")


def _sync_folder(path):
    """Let the new names survive a power failure, too, where the file system can."""
    try:
        fd = os.open(os.path.dirname(path) or ".", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return
    try:
        os.fsync(fd)
    except OSError:
        pass
    finally:
        os.close(fd)


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask
