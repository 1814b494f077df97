"""Where this package's own files are: message definitions, the stock configuration.

They lie elsewhere in a checkout (which a devel space points into), in a catkin install space and in what pip installs.
"""
from __future__ import annotations

from pathlib import Path

from car_interface.common.errors import CarInterfaceError


def package_file(name: str) -> Path:
    """A file or folder of this package, such as ``msg`` or ``config/turn_arb.yaml``.

    Raises:
        CarInterfaceError: it isn't there.
    """
    for folder in Path(__file__).resolve().parents:
        for place in (folder / "share" / "car_interface", folder):
            # pip's places have the files alone; the root of a checkout is known by its package.xml.
            if (place / name).exists() and (place != folder or (folder / "package.xml").exists()):
                return place / name
    raise CarInterfaceError(f"{name} of car_interface is missing beside {Path(__file__).resolve().parent}: "
                            "install the package again")
