"""Recordings of a car with a VESC, as F1TENTH's are: a synthetic drive, written as the VESC's nodes would.

The messages follow the packages' definitions; no recording of a real car is at hand.
"""
import csv
from pathlib import Path

import numpy as np
import pytest

from car_interface.common.units import stamp_ns, yaw_rad
from car_interface.throttle.value_map import load_value_map
from car_interface.tools.calibration.steering.recorded import load_steering_drive
from car_interface.tools.calibration.value_map.recorded import MapConfig, load_map_drive
from car_interface.tools.cli.main import main
from car_interface.tools.recordings.recording import read
from car_interface.tools.report.page import page
from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from tools.calibration.value_map.synthetic import messages_of
from written_recordings import START_NS, Written, odometry, stamp, write_ros1, write_ros2

SECONDS = 130.0
ERPM_PER_MPS, DUTY_CYCLE_PER_VALUE = 4614.0, 0.2
PULSE_0, PULSE_1 = 65536 / 20, 65536 / 10  # 1 and 2 ms of 20 ms
FULL_V, EMPTY_V = 8.2, 7.4
CORE, SERVO, SPEED = "sensors/core", "sensors/servo_position_command", "commands/motor/speed"
STATE, STAMPED, FLOAT = "vesc_msgs/VescState", "vesc_msgs/VescStateStamped", "std_msgs/Float64"


def floats(names):
    return "\n".join(f"float64 {name}" for name in names.split())


# VescState as its packages have had it: mit-racecar/vesc, the same for firmware 5, and f1tenth/vesc for ROS 2.
LAYOUTS = {
    "ros1": floats("voltage_input temperature_pcb current_motor current_input speed duty_cycle charge_drawn "
                   "charge_regen energy_drawn energy_regen displacement distance_traveled") + "\nint32 fault_code",
    "firmware_5": floats("temp_fet temp_motor avg_motor_current avg_input_current avg_id avg_iq duty_cycle_now speed "
                         "INPUT_VOLTAGE amp_hours").replace("64", "32"),
    "ros2": floats("temp_fet temp_motor current_motor current_input avg_id avg_iq duty_cycle speed voltage_input "
                   "charge_drawn charge_regen energy_drawn energy_regen") + "\nint32 displacement\nint32 "
            "distance_traveled\nint32 fault_code\nfloat64 pid_pos_now\nint32 controller_id\n"
            + floats("ntc_temp_mos1 ntc_temp_mos2 ntc_temp_mos3 avg_vd avg_vq")}


def types(layout):
    return [(STATE, LAYOUTS[layout]), (STAMPED, f"std_msgs/Header header\n{STATE} state")]


def core(time_s, speed_mps=0.0, value=0.0, layout="ros1", below="/"):
    voltage, duty_cycle = ("INPUT_VOLTAGE", "duty_cycle_now") if layout == "firmware_5" else (
        "voltage_input", "duty_cycle")
    return Written(time_s, below + CORE, STAMPED, {"header": {"stamp": stamp(time_s)}, "state": {
        voltage: FULL_V + (EMPTY_V - FULL_V) * time_s / SECONDS, duty_cycle: DUTY_CYCLE_PER_VALUE * value,
        "speed": ERPM_PER_MPS * speed_mps}})


def number(time_s, topic, data):
    return Written(time_s, topic, FLOAT, {"data": data})


def as_vesc(bag, layout, below, until_s=SECONDS):
    speed_mps, messages = 0.0, []
    for time_ns, topic, message in read(bag, ["odom", "/servo/output", "generic/output/value"]):
        time_s = (time_ns - START_NS) / 1e9
        if time_s > until_s:
            break
        if topic == "odom":
            pose, speed_mps = message.pose.pose, message.twist.twist.linear.x
            one = odometry((stamp_ns(message.header.stamp) - START_NS) / 1e9, pose.position.x, pose.position.y,
                           yaw_rad(pose.orientation), speed_mps, f"{below}odom")._replace(time_s=time_s)
        elif topic == "/servo/output":
            position = (message.data[0] - PULSE_0) / (PULSE_1 - PULSE_0)
            one = number(time_s, below + SERVO, min(1.0, max(0.0, position)))  # as the driver clips it
            messages.append(number(time_s, below + SPEED, ERPM_PER_MPS * speed_mps + 100.0))
        else:
            one = core(time_s, speed_mps, message.data, layout, below)
        messages.append(one)
    return messages


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return str(write_ros1(tmp_path_factory.mktemp("drive") / "drive.bag", messages_of(SECONDS)))


@pytest.fixture(scope="module")
def vesc_bag(bag, tmp_path_factory):
    """With the topics below /vesc, as F1TENTH's ROS 1 launch files have them, and another odometry."""
    others = [odometry(0.05 * index, topic="/pf/pose/odom") for index in range(100)]
    messages = sorted([*as_vesc(bag, "ros1", "/vesc/"), *others], key=lambda message: message.time_s)
    return str(write_ros1(tmp_path_factory.mktemp("vesc") / "vesc.bag", messages, extra_types=types("ros1")))


@pytest.fixture(scope="module", params=LAYOUTS)
def layout_bag(request, bag, tmp_path_factory):
    """20 s as each kind of recording: two of ROS 1, and a ROS 2 one without definitions."""
    messages, folder = as_vesc(bag, request.param, "/", 20.0), tmp_path_factory.mktemp(request.param)
    if request.param == "ros2":
        return str(write_ros2(folder / "vesc", messages, with_definitions=False, extra_types=types("ros2")))
    return str(write_ros1(folder / "vesc.bag", messages, extra_types=types(request.param)))


@pytest.mark.more
def test_positions_of_the_servo_are_the_pulses_that_the_vesc_makes_of_them(bag, vesc_bag):
    by_duty, by_position = load_steering_drive(bag, 0, use_imu=False), load_steering_drive(vesc_bag, 0)
    duties = [np.clip(drive.duty, PULSE_0, PULSE_1) for drive in (by_duty.drive, by_position.drive)]
    changes = [duty[np.abs(np.diff(duty, prepend=0.0)) > 0.01] for duty in duties]
    assert changes[0].size > 50
    np.testing.assert_allclose(*changes)
    assert np.ptp(by_position.drive.yaw_rad) > 1.0, "by the VESC's odometry"
    (note,) = by_position.notes
    assert note == ("no duties of the servo were recorded: the positions 0 to 1 on vesc/sensors/servo_position_command "
                    "count as 3277 to 6554, the pulses of 1 to 2 ms that a VESC makes of them")


@pytest.mark.more
def test_duty_cycle_of_the_vesc_is_the_value_of_a_value_map(layout_bag, bag):
    vesc, virtual = (load_map_drive(path, MapConfig()) for path in (layout_bag, bag))
    count = vesc.drive.value.y.size
    assert count > 150
    np.testing.assert_allclose(vesc.drive.value.y, DUTY_CYCLE_PER_VALUE * virtual.drive.value.y[:count], atol=1e-6)
    assert vesc.notes == ("sensors/core: the value is a VESC's duty cycle, -1 to 1",)


@pytest.mark.once
def test_value_map_is_made_of_the_vesc_s_recording(vesc_bag, tmp_path, capsys):
    assert main("calibrate_value_map", [vesc_bag, "-o", str(tmp_path / "map.csv"), "--delay", "0"]) == 0
    table = load_value_map(str(tmp_path / "map.csv"))
    assert -1 <= min(table.values) < 0 < max(table.values) <= 1
    assert "vesc/sensors/core: the value is a VESC's duty cycle" in capsys.readouterr().out


@pytest.mark.more
def test_report_shows_voltage_duty_cycle_servo_and_motor(layout_bag):
    traces = summarize(layout_bag).traces
    assert traces["battery voltage"].maximum == pytest.approx(FULL_V, abs=0.01)
    assert traces["battery voltage"].minimum == pytest.approx(FULL_V - 0.8 * 20 / SECONDS, abs=0.01)
    assert 0 < traces["value"].maximum <= 1
    assert 0 <= traces["servo position"].minimum < traces["servo position"].maximum <= 1
    assert traces["motor speed asked"].maximum == pytest.approx(traces["motor speed"].maximum + 100, rel=0.02)
    assert traces["speed"].maximum == pytest.approx(traces["motor speed"].maximum / ERPM_PER_MPS, rel=0.02)


@pytest.mark.more
def test_page_has_the_battery(vesc_bag):
    drive = summarize(vesc_bag)
    drawn = plots(drive)
    assert {"steering", "speed", "battery"} <= set(drawn)
    text = page(drive, drawn)
    assert '<section id="battery">' in text and "<th>Battery</th><td>7.40 to 8.20 V</td>" in text and not drive.notes


@pytest.mark.more
def test_table_of_drives_has_the_least_voltage(vesc_bag, tmp_path):
    assert main("drives", [str(Path(vesc_bag).parent), "-o", str(tmp_path / "drives.html"), "--jobs", "1"]) == 0
    (row,) = csv.DictReader((tmp_path / "drives.csv").open(encoding="utf-8"))
    assert float(row["battery_min_v"]) == pytest.approx(EMPTY_V, abs=0.01) and float(row["distance_km"]) > 0.05
    assert row["notes"] == ""


@pytest.mark.parametrize("battery, expected", [([7.9, 7.1, 7.6], 7.1), ([7.9, 0.0, float("nan")], 7.9),
                                               ([0.0], None)], ids=["least", "not_measured", "never_measured"])
def test_battery_state_goes_before_the_vesc_s_voltage(battery, expected, tmp_path):
    messages = [odometry(0.0), core(0.5), *(Written(1.0 + index, "/battery_state", "sensor_msgs/BatteryState", {
        "voltage": voltage}) for index, voltage in enumerate(battery))]
    path = write_ros1(tmp_path / "a.bag", messages, extra_types=types("ros1"))
    trace = summarize(str(path)).traces["battery voltage"]
    assert (trace.minimum if trace.count else None) == (None if expected is None else pytest.approx(expected))


def test_what_only_has_the_name_of_a_vesc_s_topic_is_not_read(tmp_path):
    messages = [odometry(0.0), *(Written(0.1, topic, "std_msgs/String", {"data": "x"})
                                 for topic in (f"/{CORE}", f"/{SERVO}", f"/{SPEED}", "/battery_state"))]
    drive = summarize(str(write_ros1(tmp_path / "a.bag", messages)))
    assert drive.present == {"odom"}


def test_position_that_no_servo_has_is_no_duty(tmp_path):
    messages = [odometry(0.1 * index) for index in range(30)] + [
        number(0.1 * index, f"/{SERVO}", position) for index, position in enumerate((0.0, 0.5, 1.0, 1.5, -0.1))]
    drive = load_steering_drive(str(write_ros1(tmp_path / "a.bag", messages)), 0).drive
    np.testing.assert_allclose(drive.duty, [3276.8, 4915.2, 6553.6, np.nan, np.nan])
