"""Recordings of every kind, good and bad: what comes out, and the one line that says why nothing does."""
import io
import os
import shutil
import sys
from pathlib import Path

import pytest

from car_interface.tools.recordings import recording
from car_interface.tools.recordings.recording import NoRecording, contents, read, require
from written_recordings import START_NS, Written, odometry, write_ros1, write_ros2

MCAP = Path(__file__).resolve().parents[3] / "data" / "autoware_mcap"
VALUES = [Written(0.1 * index, "/generic/output/value", "car_interface/Float64Stamped", {"data": float(index)})
          for index in range(10)]
ODOMETRY = [odometry(0.1 * index, x_m=float(index)) for index in range(10)]
UNHEARD = ("unheard_msgs/Of", "float64 depth")
ODD = Written(0.05, "/odd", "unheard_msgs/Of", {"depth": 1.0})


def data_of(recorded):
    return [message.message.data for message in recorded]


@pytest.fixture(params=["ros1", "ros2", "ros2_without_definitions"])
def bag(request, tmp_path):
    """The same messages as each kind of recording."""
    if request.param == "ros1":
        return write_ros1(tmp_path / "a.bag", VALUES + ODOMETRY)
    return write_ros2(tmp_path / "a", VALUES + ODOMETRY, with_definitions=request.param == "ros2")


# --- what comes out ---

def test_messages_come_in_order_with_their_time_and_the_name_asked_for(bag):
    assert {name: topic.type for name, topic in contents(str(bag)).topics.items()} == {
        "/generic/output/value": "car_interface/msg/Float64Stamped", "/odom": "nav_msgs/msg/Odometry"}
    recorded = list(read(str(bag), ["odom", "generic/output/value", "never/heard"]))
    assert [message.time_ns for message in recorded] == sorted(2 * [
        START_NS + index * 100_000_000 for index in range(10)])
    assert {message.topic for message in recorded} == {"odom", "generic/output/value"}
    assert data_of(one for one in recorded if one.topic != "odom") == [float(index) for index in range(10)]


def test_contents_tell_how_much_there_is_and_from_when_to_when(bag):
    found = contents(str(bag))
    assert [topic.count for topic in found.topics.values()] == [10, 10]
    assert (found.start_ns, found.end_ns - START_NS) == (START_NS, pytest.approx(900_000_000, abs=1))


def test_type_is_checked_by_either_spelling_and_a_wrong_one_names_topic_file_and_both_types(bag):
    assert len(list(read(str(bag), {"odom": "nav_msgs/Odometry"}))) == 10
    assert len(list(read(str(bag), {"odom": ("std_msgs/Float32", "nav_msgs/msg/Odometry")}))) == 10
    with pytest.raises(NoRecording, match="/odom is of type nav_msgs/Odometry; accepted: std_msgs/Float32") as caught:
        list(read(str(bag), {"odom": "std_msgs/Float32"}))
    assert str(bag) in str(caught.value)


def test_mcap_of_autoware_is_read_by_its_folder_and_by_its_file():
    for path in (MCAP, MCAP / "autoware_mcap.mcap"):
        commands = list(read(str(path), {"control/command/control_cmd": "autoware_control_msgs/Control"}))
        assert [command.message.longitudinal.acceleration for command in commands] == [0.25] * 20
    assert contents(str(MCAP)).topics["/odd"].type == "tier4_vehicle_msgs/msg/Unheard"


@pytest.mark.parametrize("asked, namespace, found", [
    pytest.param("odom", "/car1", ["/car1/odom"], id="relative_name_below_the_namespace"),
    pytest.param("odom", "car1/", ["/car1/odom"], id="namespace_without_and_with_slashes"),
    pytest.param("/diagnostics", "/car1", ["/diagnostics"], id="absolute_name_that_did_not_move"),
    pytest.param("/servo/output", "/car1", ["/car1/servo/output"], id="absolute_name_that_moved"),
    pytest.param("diagnostics", "/car1", [], id="relative_name_is_never_taken_as_absolute"),
])
def test_name_is_looked_up_below_the_namespace_first(asked, namespace, found):
    recorded = ["/car1/odom", "/diagnostics", "/car1/servo/output", "/servo/output"]
    assert recording.absolute_names(recorded, [asked], namespace) == dict.fromkeys(found, asked)


# --- what nobody knows ---

@pytest.mark.parametrize("write, definitions", [(write_ros1, {}), (write_ros2, {"with_definitions": False})])
def test_unknown_type_is_left_alone_unless_it_is_asked_for(write, definitions, tmp_path):
    path = write(tmp_path / "a.bag", [ODD, *VALUES], extra_types=[UNHEARD], **definitions)
    assert len(list(read(str(path), ["generic/output/value"]))) == 10
    assert contents(str(path)).topics["/odd"].type == "unheard_msgs/msg/Of"
    if definitions:
        with pytest.raises(NoRecording, match=r"a\.bag: /odd can't be read: .* its type unheard_msgs/msg/Of"):
            list(read(str(path), ["odd"]))


def test_definition_that_makes_no_sense_matters_only_when_it_is_asked_for(tmp_path):
    path = write_ros1(tmp_path / "a.bag", [ODD, *VALUES], extra_types=[UNHEARD])
    path.write_bytes(path.read_bytes().replace(b"float64 depth", b"flaot64 [epth"))
    assert len(list(read(str(path), ["generic/output/value"]))) == 10
    with pytest.raises(NoRecording, match=r"a\.bag: /odd can't be read: [^\n]* makes no sense$"):
        list(read(str(path), ["odd"]))


# --- bad bags: one line that names topic and file ---

def whole(tmp_path):
    return write_ros1(tmp_path / "a.bag", VALUES * 1 + ODOMETRY, chunk_bytes=300)


def cut(tmp_path, share=0.6):
    path = whole(tmp_path)
    path.write_bytes(path.read_bytes()[:int(path.stat().st_size * share)])
    return path


def unindexed(tmp_path):
    path = whole(tmp_path)
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:at] + bytes(8) + data[at + 8:])
    return path


def chunk_overwritten(tmp_path):
    path = whole(tmp_path)
    data = bytearray(path.read_bytes())
    at = data.index(b"compression=none") + 40
    data[at:at + 60] = b"\xff" * 60
    path.write_bytes(data)
    return path


def with_text(text, name="a.bag"):
    def make(tmp_path):
        (tmp_path / name).write_bytes(text)
        return tmp_path / name
    return make


def ros2_with(change):
    def make(tmp_path):
        path = write_ros2(tmp_path / "a.bag", VALUES)
        change(path)
        return path
    return make


def cut_database(path):
    (database,) = path.glob("*.db3")
    database.write_bytes(database.read_bytes()[:5000])


def cut_mcap(tmp_path):
    shutil.copytree(str(MCAP), str(tmp_path / "a.bag"))
    file = tmp_path / "a.bag" / "autoware_mcap.mcap"
    file.write_bytes(file.read_bytes()[:9000])
    return tmp_path / "a.bag"


@pytest.mark.parametrize("make, words", [
    pytest.param(lambda tmp_path: tmp_path / "a.bag", "there is no such file", id="missing"),
    pytest.param(with_text(b""), "it is empty", id="empty_file"),
    pytest.param(with_text(b"\xff\xfe\x00" * 50), "it is no bag$", id="binary_rubbish"),
    pytest.param(with_text(b"\xff\xfe\x00" * 50, "a.mcap"), "it is no MCAP file$", id="mcap_of_rubbish"),
    pytest.param(with_text(b"\xff\xfe\x00" * 50, "a.db3"), "it is no SQLite database$", id="database_of_rubbish"),
    pytest.param(with_text(b"#ROSBAG V2.0\n" + b"\xff\xfe\x00" * 50), "damaged", id="rubbish_behind_the_first_line"),
    pytest.param(with_text(b"#ROSBAG V1.2\n"), r"recording: Bag version \d+ is not supported$", id="old_version"),
    pytest.param(cut, r"a\.bag is cut off or damaged \([\w :.]+\w\): rosbag reindex .*a.bag saves", id="truncated"),
    pytest.param(lambda tmp_path: cut(tmp_path, 0.02), "cut off or damaged|never closed", id="truncated_in_its_head"),
    pytest.param(unindexed, "never closed: if its recorder still runs, end it by Ctrl-C; if it was killed: rosbag "
                 "reindex .*a.bag", id="unindexed"),
    pytest.param(chunk_overwritten, "damaged", id="overwritten_in_the_middle"),
    pytest.param(lambda tmp_path: tmp_path, "a ROS 2 bag's folder has a metadata.yaml", id="folder_that_is_no_bag"),
    pytest.param(ros2_with(lambda path: (path / "metadata.yaml").write_text("a: [")), "its metadata.yaml isn't a ROS 2",
                 id="ros2_bad_metadata"),
    pytest.param(ros2_with(lambda path: (path / "metadata.yaml").write_bytes(b"\xff\x00")), "metadata.yaml isn't",
                 id="ros2_metadata_of_rubbish"),
    pytest.param(ros2_with(lambda path: next(path.glob("*.db3")).write_bytes(b"\xff\x00" * 50)),
                 r"recording: \S+.db3 is no SQLite database$", id="ros2_database_of_rubbish"),
    pytest.param(ros2_with(lambda path: next(path.glob("*.db3")).unlink()), "missing", id="ros2_without_its_database"),
    pytest.param(ros2_with(cut_database), "damaged|can't be read", id="ros2_truncated_database"),
    pytest.param(cut_mcap, "damaged|can't be read", id="ros2_truncated_mcap"),
])
def test_bad_bag_is_told_in_one_line_that_names_it(make, words, tmp_path):
    path = make(tmp_path)
    with pytest.raises(NoRecording, match=words) as caught:
        list(read(str(path), ["odom", "generic/output/value", "control/command/control_cmd"]))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["drive.bag", "drive.db3"])
@pytest.mark.parametrize("make, kind", [
    pytest.param(lambda path: os.mkfifo(str(path)), "a pipe", id="pipe"),
    pytest.param(lambda path: path.symlink_to("/dev/zero"), "a device", id="device"),
])
def test_what_is_no_file_is_told_by_its_kind_and_not_waited_for(tmp_path, name, make, kind):
    path = tmp_path / name
    make(path)
    with pytest.raises(NoRecording, match=f"{path} can't be read as a recording: it is {kind}$"):
        contents(str(path))


def test_damaged_message_names_its_topic(tmp_path):
    path = whole(tmp_path)
    data = path.read_bytes()
    # A frame_id that claims to be longer than the message.
    path.write_bytes(data.replace(b"\x04\x00\x00\x00odom", b"\xff\xff\xff\x7fodom"))
    with pytest.raises(NoRecording, match=r"a\.bag is damaged: a message of /odom can't be read as nav_msgs"):
        list(read(str(path), ["odom"]))


def test_missing_topic_is_named_with_its_file_and_what_is_alike(bag):
    require(str(bag), ["odom", "generic/output/value"])
    with pytest.raises(NoRecording, match="has no topic imu/data, for the slope; it has /generic") as caught:
        require(str(bag), ["odom", "imu/data"], why="for the slope")
    assert str(bag) in str(caught.value)
    with pytest.raises(NoRecording, match="no topic odom below /car1; it has /odom"):
        require(str(bag), ["odom"], "/car1")


def test_topic_that_its_type_would_refuse_is_not_offered_for_a_missing_one(bag):
    hint = "; name another by --map TOPIC=imu"
    with pytest.raises(NoRecording, match=r"no topic imu, for the slope; name .* TOPIC=imu; it has /odom$"):
        require(str(bag), {"imu": ("sensor_msgs/Imu", "nav_msgs/Odometry")}, why="for the slope", hint=hint)
    with pytest.raises(NoRecording, match=r"no topic imu, for the slope; it has none of type sensor_msgs/Imu$"):
        require(str(bag), {"imu": "sensor_msgs/Imu"}, why="for the slope", hint=hint)


# --- the bar ---

@pytest.mark.parametrize("is_terminal", [True, False])
def test_bar_with_the_recordings_name_shows_on_a_terminal_only(bag, monkeypatch, is_terminal):
    shown = io.StringIO()
    shown.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", shown)
    assert len(list(read(str(bag), ["odom"], progress=True))) == len(ODOMETRY)
    assert (bag.name in shown.getvalue()) is is_terminal
