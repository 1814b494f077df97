"""What each node makes of its parameters, and what the launch files give it: reading them does nothing."""
import importlib
import os
import re
import shutil

import pytest

from car import CONFIG, config
from car_interface.common.declared import read_all
from car_interface.common.errors import ConfigError
from car_interface.common.params import Params
from car_interface.ros.start import config_class

PACKAGE = os.path.dirname(os.path.realpath(CONFIG))
WHOLE_PATH = "accepted: a whole path, from / on, such as $PWD/my_car makes: nodes run in another folder, and ~ is no"
MAP = {"csv_path_value_map": f"{PACKAGE}/config/value_map.csv"}
STEERING = {name: value for name, value in config("turn_arb.yaml").items() if name.startswith(("servo_", "m_", "k_"))}
ESC = {"servo": config("throttle.yaml")["servo"]}
BUTTONS = {"steer_axis": 0, "throttle_axis": 4, "manual_button": 4, "autonomous_button": 5}
# What each node's configuration can't do without. Defaults and ranges are those of docs/nodes.md, which a test holds
# against the declarations.
REQUIRED = {"turn_arb": STEERING, "generic_value_converter": MAP, "throttle_arb": ESC, "teleop_logi": BUTTONS,
            "planner_interface": {"source": "drive"}, "pca9685": {}, "teensy_sensor_hub": {}, "car_sim": {},
            "gamepad_joy": {}, "black_box": {}, "car_display": {}, "demo_drive": {}, "keyboard_drive": {}}
# Node, what is given besides the required ones, and how the one line begins.
REFUSALS = [
    ("keyboard_drive", {"manual_button": 5}, "autonomous_button is 5; accepted: a button other than manual_button's"),
    ("turn_arb", {"k_pwmcmd_left_table_servo": [1, 2]},
     "k_pwmcmd_left_table_servo is [1.0, 2.0]; accepted: 15 numbers"),
    ("turn_arb", {"save_to": "~/turn_arb.yaml"}, f"save_to is '~/turn_arb.yaml'; {WHOLE_PATH}"),
    ("generic_value_converter", {"csv_path_value_map": "/nowhere.csv"},
     "csv_path_value_map is '/nowhere.csv'; accepted: a file that can be read"),
    ("generic_value_converter", {"max_value": -9}, "min_value is -5.0; accepted: at most max_value -9.0"),
    ("generic_value_converter", {"min_value": 8, "max_value": 9}, f"{MAP['csv_path_value_map']}, value map has values"),
    ("pca9685", {"steering": 5}, "unknown parameter steering is 5; accepted: only address, "),
    ("pca9685", {"device": "virtual", "virtual_log": "chip.log"}, f"virtual_log is 'chip.log'; {WHOLE_PATH}"),
    ("pca9685", {"virtual_log": "/tmp/chip.log"}, "unknown parameter virtual_log is '/tmp/chip.log'"),
    ("teensy_sensor_hub", {"sonar_sequence": [0, 1.5]}, "sonar_sequence is [0.0, 1.5]; accepted: up to 24 "),
    ("teensy_sensor_hub", {"odom_rate": "1e-310"}, "odom_rate is 1e-310; accepted: 0, or a number from 0.1 to 1000"),
    ("teensy_sensor_hub", {"sonars": {"front_left": [1, 2]}},
     "sonars/front_left is [1.0, 2.0]; accepted: three numbers: x, y in m, and yaw in rad"),
    ("car_sim", {"steering_duties": [3800, 6700]}, "steering_curvatures is "),
    ("car_sim", {"wheel_pulses": [1]}, "wheel_pulses is [1.0]; accepted: two numbers: left, right"),
    ("gamepad_joy", {"dev": "js0"}, "dev is 'js0'; accepted: auto, or a path such as /dev/input/event5"),
    ("demo_drive", {"bag_dir": "bags"}, f"bag_dir is 'bags'; {WHOLE_PATH}"),
]


def read(node, values):
    if node == "demo_drive":
        return importlib.import_module(node).read_config(Params(values))
    return read_all(Params(values), config_class(node))


def loaded(file, *arguments):
    """What roslaunch makes of a launch file; a Python without it skips the test."""
    load = pytest.importorskip("roslaunch.config").load_config_default
    return load([(f"{PACKAGE}/launch/{file}", [*arguments])], None, verbose=False)


def below(launch, namespace):
    return {name[len(namespace):]: param.value for name, param in launch.params.items() if name.startswith(namespace)}


@pytest.mark.parametrize("node, given, begin", REFUSALS)
def test_bad_parameter_is_named_with_its_value_and_what_is_accepted(node, given, begin):
    with pytest.raises(ConfigError) as error:
        read(node, {**REQUIRED[node], **given})
    assert str(error.value).startswith(begin)


@pytest.mark.parametrize("node", REQUIRED)
def test_missing_and_unknown_parameters_are_named(node):
    required = REQUIRED[node]
    read(node, required)
    for missing in required:
        with pytest.raises(ConfigError, match=f"^{missing}(/channel)? is missing; accepted: "):
            read(node, {name: value for name, value in required.items() if name != missing})
    with pytest.raises(ConfigError, match=r"^unknown parameter no_such_thing is 1; accepted: only "):
        read(node, {**required, "no_such_thing": 1})


def test_simulated_car_has_what_a_car_s_files_say_and_its_own_parameters_go_before_them():
    files = {"steering": {**config("turn_arb.yaml"), "servo_channel": 7}, "esc": {"servo": {"channel": 9,
             "neutral": 5000}}, "wheels": {**config("teensy_sensor_hub.yaml"), "wheel_diameter": 0.12}}
    made = read("car_sim", files)
    assert (made.steering_channel, made.throttle_channel) == (7, 9)
    assert (made.vehicle.wheel_diameter_m, made.vehicle.drive.neutral_duty) == (0.12, 5000)
    assert (made.vehicle.steering.center_duty, dict(made.vehicle.steering.curve)[3800]) == (5100, 1.0)
    mixed = read("car_sim", {**files, "wheel_diameter": 0.1, "steering_channel": 2})
    assert (mixed.vehicle.wheel_diameter_m, mixed.steering_channel) == (0.1, 2)
    assert read("car_sim", {"esc": {"servo": {"channel": -1}}}).throttle_channel == 1


def test_simulated_room_without_obstacles_has_its_walls_and_no_car_starts_in_one():
    empty, full = read("car_sim", {"obstacles": False}).world, read("car_sim", {}).world
    assert (empty.boxes, empty.posts, empty.walls) == ((), (), full.walls)
    assert full.boxes and full.posts
    with pytest.raises(ConfigError) as error:
        read("car_sim", {"start": [5.9, 0, 0]})
    assert str(error.value) == ("start is [5.9, 0.0, 0.0]; accepted: a place where the car touches no wall, box or "
                                "post, or collisions: false")


def test_reading_opens_and_makes_nothing(tmp_path):
    for node, given in (("pca9685", {"device": "virtual", "virtual_log": f"{tmp_path}/chip", "required": True}),
                        ("car_sim", {"port": f"{tmp_path}/teensy"}), ("demo_drive", {"bag_dir": f"{tmp_path}/bags"}),
                        ("teensy_sensor_hub", {"port": f"{tmp_path}/teensy", "required": True}),
                        ("turn_arb", {"save_to": f"{tmp_path}/b.yaml"})):
        files = os.listdir("/proc/self/fd")
        read(node, {**REQUIRED[node], **given})
        assert os.listdir("/proc/self/fd") == files
    assert os.listdir(tmp_path) == []


# --- launch files ---

@pytest.mark.parametrize("file, argument, refusal", [
    ("pca9685.launch", "device:=virtual", "device is called i2c now: i2c:=virtual"),
    ("car_nodes.launch", "device:=virtual", "device is called i2c now: i2c:=virtual"),
    ("pca9685.launch", "device:=1", "device is called i2c now: i2c:=1"),
    ("pca9685.launch", "steering_config:=/a/b.yaml", "steering_config is gone: config:= is a folder with turn_arb."),
    ("pca9685.launch", "throttle_config:=/a/b.yaml", "throttle_config is gone: config:= is a folder with throttle."),
    ("teensy_sensor_hub.launch", "sonars_config:=/a/b.yaml", "sonars_config is gone: config:= is a folder with sonars"),
    ("throttle_arb.launch", "sonars_config:=/a/b.yaml", "sonars_config is gone: config:= is a folder with sonars.yaml"),
    ("throttle_arb.launch", "board_config:=/a/b.yaml", "board_config is gone: config:= is a folder with pca9685.yaml"),
    ("planner_interface.launch", "wheels_config:=/a/b.yaml", "wheels_config is gone: config:= is a folder with teensy"),
    ("planner_interface.launch", "source:=cmd_vel", "source is called planner now: planner:=cmd_vel"),
    ("turn_arb.launch", "config:=/home/me/my car/turn_arb.yaml", "config is a folder now: config:=/home/me/my car"),
    ("display.launch", "config:=/home/me/car.rviz", "config is a folder now: config:=/home/me"),
])
def test_launch_file_refuses_an_argument_by_its_old_name_and_says_the_new_one(file, argument, refusal):
    with pytest.raises(Exception, match=re.escape(refusal)):
        loaded(file, argument)


@pytest.mark.parametrize("file, arguments", [("pca9685.launch", []), ("car.launch", ["one_process:=true"])])
@pytest.mark.parametrize("throttle, neutral", [("false", 0), ("true", 4915)])
def test_launch_file_gives_the_board_the_files_of_turn_arb_and_of_throttle_arb(file, arguments, throttle, neutral):
    made = read("pca9685", below(loaded(file, f"throttle:={throttle}", *arguments), "/pca9685/"))
    assert [channel.timeout_value for channel in made.channels] == [5100, neutral] + [0] * 14


def test_launch_files_tell_a_node_that_it_is_respawned():
    found = set()
    for arguments in ([], ["one_process:=true"], ["display:=true"]):
        for node in loaded("car.launch", *arguments).nodes:
            if node.package == "car_interface":
                assert (dict(node.env_args).get("CAR_INTERFACE_RESPAWN") == "true") == node.respawn, node.type
            found.add(node.type)
    assert {"turn_arb", "car_nodes", "car_display", "gamepad_joy"} <= found


@pytest.mark.parametrize("one_process", ["false", "true"])
def test_planner_takes_the_car_s_topics_and_the_converter_takes_the_planner_s(one_process):
    launch = loaded("car.launch", "ns:=car1", "planner:=autoware", "throttle:=true", "gamepad:=false",
                    f"one_process:={one_process}")
    kinds = ("car_nodes",) if one_process == "true" else ("planner_interface", "generic_value_converter")
    remaps = {source.replace("~", f"{node.type}/"): target for node in launch.nodes if node.type in kinds
              for source, target in node.remap_args}
    planner = {name.rpartition("/")[2]: target for name, target in remaps.items()
               if name.startswith("planner_interface/input/")}
    assert planner == {"control_cmd": "control/command/control_cmd", "gear_cmd": "control/command/gear_cmd",
                       "odometry": "odom"}
    assert remaps["generic_value_converter/input/control_cmd"] == "planner_interface/output/control_cmd"
    values = below(launch, "/car1/planner_interface/")
    assert (values["source"], values["wheels/wheelbase"], values["max_speed"]) == ("autoware", 0.324, 3.0)


def test_car_to_practise_with_has_a_steering_of_its_own_and_obeys_speeds():
    launch = loaded("practice.launch", "ns:=car1")
    values = below(launch, "/car1/")
    assert (values["planner_interface/source"], values["car_sim/steering_duties"][0]) == ("speed", 3800)
    assert not values["car_sim/obstacles"] and "car_sim/steering/servo_center" not in values
    assert "demo_drive" not in [node.type for node in launch.nodes]


@pytest.mark.parametrize("one_process", ["false", "true"])
@pytest.mark.parametrize("line, grants", [("", False), ("grant_at_start: true", True)])
def test_car_grants_nothing_at_its_start_unless_its_owner_s_file_says_so(tmp_path, one_process, line, grants):
    shutil.copytree(CONFIG, tmp_path / "mine")
    for path in (tmp_path / "mine").glob("*.yaml"):
        path.write_text(path.read_text(encoding="utf-8").replace("grant_at_start: false", line), encoding="utf-8")
    launch = loaded("car.launch", f"config:={tmp_path}/mine", "throttle:=true", f"one_process:={one_process}")
    assert [below(launch, f"/{node}/")["grant_at_start"] for node in ("turn_arb", "throttle_arb")] == [grants] * 2


@pytest.mark.parametrize("file, arguments, device", [
    ("car.launch", [], "auto"), ("car.launch", ["joy_device:=/dev/input/js0"], "/dev/input/js0"),
    ("car.launch", ["gamepad:=false"], None),
    ("teleop_logi.launch", ["gamepad:=true", "joy_device:=/dev/input/js7"], "/dev/input/js7")])
def test_gamepad_is_read_by_this_package_under_the_name_of_the_usual_driver_unless_it_comes_from_elsewhere(
        file, arguments, device):
    launch = loaded(file, *arguments)
    assert [node.type for node in launch.nodes if node.name == "joy_node"] == ["gamepad_joy"] * (device is not None)
    assert below(launch, "/joy_node/").get("dev") == device


@pytest.mark.parametrize("one_process", ["false", "true"])
def test_demo_with_the_package_s_files_has_a_table_that_the_board_s_steps_resolve_for_arbiter_and_car(one_process):
    values = below(loaded("demo.launch", "ns:=car1", f"one_process:={one_process}"), "/car1/")
    for name in ("k_pwmcmd_left_table_servo", "k_pwmcmd_right_table_servo", "m_turnrad_axis_servo", "servo_center"):
        assert values[f"turn_arb/{name}"] == values[f"car_sim/steering/{name}"]
    duties = values["turn_arb/k_pwmcmd_left_table_servo"]
    assert duties != config("turn_arb.yaml")["k_pwmcmd_left_table_servo"]
    assert min(abs(one - other) for one, other in zip(duties, duties[1:])) >= 16
    assert values["turn_arb/servo_channel"] == 0  # the rest is that of config


def test_demo_has_every_node_take_the_folder_that_config_names(tmp_path):
    shutil.copytree(CONFIG, tmp_path / "mine")
    for path in (tmp_path / "mine").glob("*.yaml"):
        text = path.read_text(encoding="utf-8").replace("servo_channel: 0", "servo_channel: 6")
        path.write_text(text.replace("wheel_diameter: 0.1", "wheel_diameter: 0.2"), encoding="utf-8")
    values = below(loaded("demo.launch", "ns:=mine", f"config:={tmp_path}/mine"), "/mine/")
    assert {name for name, value in values.items() if name.endswith("servo_channel") and value == 6} >= {
        "turn_arb/servo_channel", "pca9685/steering/servo_channel", "car_sim/steering/servo_channel"}
    assert values["turn_arb/save_to"] == f"{tmp_path}/mine/turn_arb.yaml"
    assert {values[f"{node}/save_to_package"] for node in ("turn_arb", "throttle_arb")} == {False}
    text = str(values)
    assert os.path.realpath(CONFIG) not in text and CONFIG not in text
