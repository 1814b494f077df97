"""Replaces a file in one step: a reader sees the old content or the new one, never a part of either."""
from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time

WRITE_BITS = 0o222


def is_write_protected(path: str) -> bool:
    """Whether a file is write-protected. Replacing it needs write access to its folder only, and root may always."""
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
        OSError: nothing was changed.
    """
    folder, name = os.path.split(path)
    existed, backup_path = os.path.exists(path), None
    handle, new_path = tempfile.mkstemp(prefix=f".{name}.", dir=folder)
    try:
        with open(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if existed:
            _copy_owner(path, new_path)
        os.chmod(new_path, stat.S_IMODE(os.stat(path).st_mode) if existed else 0o666 & ~_umask())
        if existed and keeps_old:
            backup_path = _back_up(path)
        os.replace(new_path, path)
    except BaseException:
        os.unlink(new_path)
        raise
    return backup_path


def _copy_owner(path, new_path):
    owner = os.stat(path)
    try:
        os.chown(new_path, owner.st_uid, owner.st_gid)
    except PermissionError:
        pass  # only root may give files away


def _back_up(path):
    """Copy the file to a name with the time, and return that; an existing file is never overwritten."""
    stem = f"{path}.bak-{time.strftime('%Y%m%d-%H%M%S')}"
    for attempt in range(1, 1000):
        backup_path = stem if attempt == 1 else f"{stem}-{attempt}"
        try:
            with open(path, "rb") as old, open(backup_path, "xb") as new:
                shutil.copyfileobj(old, new)
            shutil.copystat(path, backup_path)
            return backup_path
        except FileExistsError:
            continue
    raise FileExistsError(f"too many files named {stem}")


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask
