"""The options by which a user says what a recorded topic is."""
import argparse

import pytest

from car_interface.common.errors import ConfigError
from car_interface.tools.cli.options import add_recording_arguments, add_scheduler_argument, topics_of
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


@pytest.mark.parametrize("address", ["foo://host:1", "host:8786", "tcp://host", "tcp://:8786x"])
def test_scheduler_that_is_no_address_is_refused_at_once(address, capsys):
    parser = argparse.ArgumentParser()
    add_scheduler_argument(parser)
    assert parser.parse_args(["--scheduler", "tcp://10.0.0.5:8786"]).scheduler == "tcp://10.0.0.5:8786"
    with pytest.raises(SystemExit):
        parser.parse_args(["--scheduler", address])
    assert f"{address!r} is no address such as tcp://192.168.1.5:8786" in capsys.readouterr().err
