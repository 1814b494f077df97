"""The version of this package."""
from __future__ import annotations

import argparse
from importlib import metadata
from xml.etree import ElementTree

from car_interface.common.errors import CarInterfaceError
from car_interface.common.package_files import package_file

PACKAGE = "car_interface"


def version() -> str:
    """The version in package.xml; where pip installed the package without that, in its metadata.

    Raises:
        CarInterfaceError: there is neither.
    """
    try:
        return ElementTree.parse(str(package_file("package.xml"))).findtext("version")
    except CarInterfaceError:
        pass
    try:
        return metadata.version(PACKAGE)
    except metadata.PackageNotFoundError as error:
        raise CarInterfaceError(f"{PACKAGE} has neither package.xml nor metadata: install it again") from error


class VersionAction(argparse.Action):
    """Prints the version and ends; it is looked up only on request."""

    def __init__(self, option_strings, dest):
        super().__init__(option_strings, dest, nargs=0, help="print the version of car_interface and end")

    def __call__(self, parser, namespace, values, option_string=None):
        print(f"{PACKAGE} {version()}")
        parser.exit()
