"""Recordings of virtual cars, made once: each takes seconds, and several files and Pythons read the same.

They stay in the folder of temporary files, below a digest of the sources that make them, for a day.
"""
import functools
import hashlib
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Callable

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("common", "interlock", "sim", "steering", "teensy", "throttle")  # what the drives are made with
MAX_AGE_S = 24 * 3600.0


@functools.lru_cache(maxsize=None)
def folder() -> Path:
    """Return the folder of these sources' recordings; remove those of sources that were used a day ago."""
    digest = hashlib.sha256()
    sources = [path for part in PARTS for path in (ROOT / "src" / "car_interface" / part).rglob("*.py")]
    for path in sorted([*sources, *(ROOT / "test" / "accuracy").glob("*.py"), *(ROOT / "msg").glob("*.msg")]):
        digest.update(f"{path.name}\0{path.stat().st_size}\0".encode())
        digest.update(path.read_bytes())
    above = Path(tempfile.gettempdir(), f"car_interface-drives-{os.getuid()}")
    found = above / digest.hexdigest()[:16]
    found.mkdir(mode=0o700, parents=True, exist_ok=True)
    os.utime(str(found))
    for other in above.iterdir():
        if other.stat().st_mtime < time.time() - MAX_AGE_S:
            shutil.rmtree(str(other), ignore_errors=True)
    return found


def recorded(write: Callable, *arguments, **options) -> str:
    """Return the path of a drive.bag that ``write(*arguments, path=…, **options)`` made, now or before."""
    name = hashlib.sha256(repr((write.__module__, write.__name__, arguments, sorted(options.items()))).encode())
    path = folder() / name.hexdigest()[:16] / "drive.bag"
    if not path.exists():
        with tempfile.TemporaryDirectory(dir=str(folder())) as made:
            write(*arguments, path=Path(made, "drive.bag"), **options)
            path.parent.mkdir(exist_ok=True)
            Path(made, "drive.bag").replace(path)
    return str(path)
