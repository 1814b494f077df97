"""Replaces files whole, in one step: what is there is the old file or the new one, never half of either."""
from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time

ANYBODY_WRITES = 0o222


def is_write_protected(path: str) -> bool:
    """Whether its owner doesn't want a file to be written: to replace it its folder would do, and for root anything."""
    return not os.access(path, os.W_OK) or not os.stat(path).st_mode & ANYBODY_WRITES


def replace(path: str, data: bytes, keeps_old: bool) -> str | None:
    """Put a new file in its place, with the old one's mode and, as far as that is allowed, owner.

    Args:
        path: no link, or that is replaced.
        data: all of it.
        keeps_old: the old file stays beside it, under a name with the time.

    Returns:
        Where the old file is now, if there was one that is kept.

    Raises:
        OSError: why not; then all is as it was.
    """
    folder, name = os.path.split(path)
    existed, aside = os.path.exists(path), None
    handle, fresh = tempfile.mkstemp(prefix=f".{name}.", dir=folder)
    try:
        with open(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if existed:
            _keep_owner(path, fresh)
        os.chmod(fresh, stat.S_IMODE(os.stat(path).st_mode) if existed else 0o666 & ~_umask())
        if existed and keeps_old:
            aside = _put_aside(path)
        os.replace(fresh, path)
    except BaseException:
        os.unlink(fresh)
        raise
    return aside


def _keep_owner(path, fresh):
    owner = os.stat(path)
    try:
        os.chown(fresh, owner.st_uid, owner.st_gid)
    except PermissionError:
        pass  # only root may give files away


def _put_aside(path):
    """Give the file a second name with the time; that name. One that is taken is never overwritten."""
    stem = f"{path}.bak-{time.strftime('%Y%m%d-%H%M%S')}"
    for attempt in range(1, 1000):
        aside = stem if attempt == 1 else f"{stem}-{attempt}"
        try:
            with open(path, "rb") as old, open(aside, "xb") as new:
                shutil.copyfileobj(old, new)
            shutil.copystat(path, aside)
            return aside
        except FileExistsError:
            continue
    raise FileExistsError(f"too many files named {stem}")


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask
