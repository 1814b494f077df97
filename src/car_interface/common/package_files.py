"""Finds this package's data files: message definitions and the default configuration.

Their place depends on the installation: a checkout (which a devel space points into), a catkin install space, or pip.
"""
from __future__ import annotations

import os
from pathlib import Path

from car_interface.common.errors import CarInterfaceError


def package_file(name: str) -> Path:
    """Return a file or folder of this package, such as ``msg`` or ``config/turn_arb.yaml``.

    Raises:
        CarInterfaceError: it wasn't found.
    """
    for folder in Path(__file__).resolve().parents:
        for place in (folder / "share" / "car_interface", folder):
            # pip installs the data files only; the root of a checkout has a package.xml.
            if (place / name).exists() and (place != folder or (folder / "package.xml").exists()):
                return place / name
    raise CarInterfaceError(f"{name} of car_interface is missing beside {Path(__file__).resolve().parent}: "
                            "install the package again")


def is_package_file(path: str) -> bool:
    """Return whether ``path`` leads, by any links, into the package's own folder of configurations."""
    try:
        own = os.path.realpath(str(package_file("config")))
    except CarInterfaceError:
        return False
    return os.path.realpath(path).startswith(own + os.sep)
