"""Replaces a file in one step: a reader sees the old content or the new one, never a part of either.

The new content is written beside the file, under a hidden name, and renamed when it is complete. A process that is
killed before that leaves it behind, and the next replacement of the file removes it. The process that writes it holds a
lock on it, so a file that is not locked is a leftover.
"""
from __future__ import annotations

import errno
import fcntl
import glob
import os
import secrets
import shutil
import stat
import time
from contextlib import suppress

WRITE_BITS = 0o222
DIGITS, DIGIT = 8, "[0-9a-f]"  # of the names of files that are not in place yet: .NAME.new-1a2b3c4d
# Of a second name for a file: the file system has none, as on a USB stick, or the file is another user's.
NOT_SUPPORTED = (errno.EOPNOTSUPP, errno.EPERM, errno.EMLINK, errno.ENOSYS)


def is_write_protected(path: str) -> bool:
    """Return whether a file is write-protected. To replace it takes access to its folder only, and root always may."""
    return not os.access(path, os.W_OK) or not os.stat(path).st_mode & WRITE_BITS


def replace(path: str, data: bytes, keeps_old: bool) -> str | None:
    """Replace a file, with the old one's mode and, as far as that is allowed, owner.

    Args:
        path: of the file; a link is replaced itself.
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
    backup_path = None
    fd, new_path = _open_new(path, 0o666 if old is None else 0o600)
    try:
        with open(fd, "wb") as file:
            file.write(data)
            file.flush()
            if old is not None:
                with suppress(PermissionError):  # only root may give files away
                    os.fchown(fd, old.st_uid, old.st_gid)
                os.fchmod(fd, stat.S_IMODE(old.st_mode))
            os.fsync(fd)
            if old is not None and keeps_old:
                backup_path = _back_up(path)
            os.replace(new_path, path)
    except BaseException:
        for left_path in filter(None, (new_path, backup_path)):
            with suppress(FileNotFoundError):
                os.unlink(left_path)
        raise
    _sync_folder(path)
    return backup_path


def _open_new(path, mode):
    """Return a new, locked file beside the one at a path: its descriptor and its path."""
    folder, name = os.path.split(path)
    while True:
        new_path = os.path.join(folder, f".{name}.new-{secrets.token_hex(DIGITS // 2)}")
        fd = os.open(new_path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        if _is_kept(fd):
            return fd, new_path
        os.close(fd)


def _remove_leftovers(path):
    """Remove what killed processes left behind when they replaced this file."""
    folder, name = map(glob.escape, os.path.split(path))
    for left_path in glob.iglob(os.path.join(folder, f".{name}.new-" + DIGIT * DIGITS)):
        # For writing, too: network drives lock nothing else. An OSError: it is gone, or somebody else's.
        with suppress(OSError), open(os.open(left_path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as left:
            if _lock(left.fileno()):
                os.unlink(left_path)


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


def _back_up(path):
    """Give the file a second name with the time, and return that; an existing file is never overwritten."""
    stem = f"{path}.bak-{time.strftime('%Y%m%d-%H%M%S')}"
    for attempt in range(1, 1000):
        backup_path = stem if attempt == 1 else f"{stem}-{attempt}"
        with suppress(FileExistsError):
            _link_or_copy(path, backup_path)
            return backup_path
    raise FileExistsError(errno.EEXIST, f"too many files named {stem}")


def _link_or_copy(path, backup_path):
    try:
        os.link(path, backup_path)
    except OSError as error:
        if error.errno not in NOT_SUPPORTED:
            raise
        with open(path, "rb") as old, open(backup_path, "xb") as backup:
            try:
                shutil.copyfileobj(old, backup)
                backup.flush()
                os.fsync(backup.fileno())
                shutil.copystat(path, backup_path)
            except BaseException:
                os.unlink(backup_path)
                raise


def _sync_folder(path):
    """Let the new names survive a power failure, too, where the file system can."""
    with suppress(OSError):
        fd = os.open(os.path.dirname(path) or ".", os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
