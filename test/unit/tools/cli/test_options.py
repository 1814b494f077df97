"""The options by which a user says what a recorded topic is."""
from __future__ import annotations

import argparse
from pathlib import Path
from xml.etree import ElementTree

import pytest

from car_interface.common.errors import CarInterfaceError, ConfigError
from car_interface.tools.cli import options as versions
from car_interface.tools.cli.options import add_recording_arguments, topics_of
from car_interface.tools.recordings.roles import ACKERMANN, IMU, ODOM, OUTPUT


def parsed(*arguments):
    parser = argparse.ArgumentParser()
    add_recording_arguments(parser, (ODOM, IMU, OUTPUT, ACKERMANN))
    return parser.parse_args(arguments)


def test_nothing_is_named_by_default_nor_by_the_usual_name():
    assert topics_of(parsed()) == topics_of(parsed("--odom", "odom"), imu=None) == {}


@pytest.mark.parametrize("arguments, topics", [
    (["--map", "/a/imu=imu", "--map", "/b=ackermann", "--odom", "/ekf"],
     {"odom": "/ekf", "imu": "/a/imu", "ackermann": "/b"}),
    (["--map", "/ekf=odom", "--odom", "/ekf"], {"odom": "/ekf"}),
    (["--map", "/a=b=odom"], {"odom": "/a=b"}),
], ids=["each_role", "the_same_twice", "equals_sign_in_a_name"])
def test_map_names_a_topic_for_each_role_and_odom_is_a_short_form(arguments, topics):
    assert topics_of(parsed(*arguments)) == topics
    assert topics_of(parsed("--map", "/ekf=odom"), imu="/a") == {"odom": "/ekf", "imu": "/a"}


@pytest.mark.parametrize("arguments, words", [
    (["--map", "/a=wheels"], "--map is '/a=wheels'; accepted: TOPIC=ROLE with a role of odom, imu, output, ackermann"),
    (["--map", "/a"], "--map is '/a'; accepted: TOPIC=ROLE"),
    (["--map", "=odom"], "--map is '=odom'; accepted: TOPIC=ROLE"),
    (["--map", "/a=odom", "--map", "/b=odom"], "accepted: one topic for each role, and /a is odom already"),
    (["--map", "/a=odom", "--odom", "/b"], "accepted: one topic for each role, and /b is odom already"),
    (["--map", "/a=odom", "--map", "/a=imu"], "accepted: one role for each topic, and /a is odom already"),
], ids=["unknown_role", "no_role", "no_topic", "two_topics", "map_and_odom", "two_roles"])
def test_what_makes_no_sense_is_refused_by_its_text(arguments, words):
    with pytest.raises(ConfigError) as caught:
        topics_of(parsed(*arguments))
    assert words in str(caught.value)


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
