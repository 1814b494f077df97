"""The version of this package: where it comes from, and the option --version."""
from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.tools.cli import version as versions

ROOT = Path(__file__).resolve().parents[4]


def test_version_is_the_one_in_package_xml_which_goes_before_the_metadata(monkeypatch):
    monkeypatch.setattr(versions.metadata, "version", {"car_interface": "1.2.3"}.__getitem__)
    assert versions.version() == ElementTree.parse(str(ROOT / "package.xml")).findtext("version")


def test_version_comes_from_the_metadata_where_there_is_no_package_xml_and_is_refused_without_either(monkeypatch):
    def missing_file(name):
        raise CarInterfaceError(name)

    def unknown(name):
        raise versions.metadata.PackageNotFoundError(name)
    monkeypatch.setattr(versions, "package_file", missing_file)
    monkeypatch.setattr(versions.metadata, "version", {"car_interface": "1.2.3"}.__getitem__)
    assert versions.version() == "1.2.3"
    monkeypatch.setattr(versions.metadata, "version", unknown)
    with pytest.raises(CarInterfaceError, match=r"has neither package\.xml nor metadata"):
        versions.version()
