"""Messages from bytes, by the recording's own definition or by one that is known here."""
import struct
from pathlib import Path
from types import SimpleNamespace

import pytest

from car_interface.tools.recordings.recording import EQUIVALENTS, IDL_RULE, UnknownType, decoder, known_types, read
from written_recordings import Written, write_ros2

ROOT = Path(__file__).resolve().parents[4]
CDR = b"\x00\x01\x00\x00"  # the header of CDR, little-endian
DEPTH = "depth_msgs/msg/Depth"
DEPTH_IDL = "module depth_msgs { module msg { struct Depth { double depth; }; }; };\n"


def connection(name, text=""):
    """A connection as rosbags before 0.10 has it."""
    return SimpleNamespace(msgtype=name, msgdef=text)


def newer_connection(name, text="", kind="MSG"):
    """A connection as rosbags from 0.10 on has it."""
    return SimpleNamespace(msgtype=name, msgdef=SimpleNamespace(data=text, format=SimpleNamespace(name=kind)))


@pytest.mark.parametrize("is_ros2, data", [(False, struct.pack("<d", 0.5)), (True, CDR + struct.pack("<d", 0.5))],
                         ids=["ros1", "ros2"])
@pytest.mark.parametrize("made", [connection, newer_connection])
def test_message_has_the_fields_of_the_recordings_definition(is_ros2, data, made):
    decode = decoder(made(DEPTH, "float64 depth"), is_ros2)
    assert decode(data).depth == 0.5


@pytest.mark.parametrize("made", [
    connection(DEPTH, f"{IDL_RULE}IDL: depth_msgs/msg/Depth\n{DEPTH_IDL}"),
    newer_connection(DEPTH, f"{IDL_RULE}IDL: depth_msgs/msg/Depth\n{DEPTH_IDL}", "IDL"),
    newer_connection(DEPTH, DEPTH_IDL, "IDL"),
], ids=["rosbags_before_0_10", "with_rule", "without_rule"])
def test_definition_may_be_in_idl(made):
    assert decoder(made, True)(CDR + struct.pack("<d", -2.5)).depth == -2.5


def test_idl_may_have_a_part_for_each_type():
    text = (f"{IDL_RULE}IDL: depth_msgs/msg/Water\n"
            "module depth_msgs { module msg { struct Water { depth_msgs::msg::Depth level; }; }; };\n"
            f"{IDL_RULE}IDL: depth_msgs/msg/Depth\n{DEPTH_IDL}")
    decode = decoder(connection("depth_msgs/msg/Water", text), True)
    assert decode(CDR + struct.pack("<d", 4.0)).level.depth == 4.0


def test_definition_may_contain_those_of_its_fields():
    text = "Depth level\n" + "=" * 80 + "\nMSG: depth_msgs/Depth\nfloat64 depth\n"
    decode = decoder(connection("depth_msgs/msg/Water", text), False)
    assert decode(struct.pack("<d", 4.0)).level.depth == 4.0


def test_two_publishers_may_have_different_definitions_of_a_type():
    one, other = (decoder(connection(DEPTH, text), False) for text in ("float64 depth", "int32 fathoms"))
    assert one(struct.pack("<d", 1.5)).depth == 1.5
    assert other(struct.pack("<i", -3)).fathoms == -3


@pytest.mark.parametrize("name, data, field, value", [
    pytest.param("std_msgs/msg/Float32", CDR + struct.pack("<f", 0.25), "data", 0.25, id="standard_type"),
    pytest.param("car_interface/msg/Float64Stamped",
                 CDR + struct.pack("<iId", 3, 4, 0.5), "data", 0.5, id="type_of_this_package"),
])
def test_known_type_needs_no_definition(name, data, field, value):
    assert getattr(decoder(connection(name), True)(data), field) == value


@pytest.mark.parametrize("made", [
    connection(DEPTH, "flaot64 [epth"), newer_connection(DEPTH, "module {", "IDL"),
    connection(DEPTH, f"{IDL_RULE}IDL: depth_msgs/msg/Depth\nstruct struct"),
], ids=["msg", "idl", "idl_with_rule"])
def test_definition_that_can_not_be_parsed_is_refused_in_one_line(made):
    with pytest.raises(UnknownType) as caught:
        decoder(made, True)
    assert str(caught.value) == f"the recording's definition of its type {DEPTH} makes no sense"


# --- known types ---

def test_autowares_equivalents_have_the_same_fields_as_this_packages_messages():
    known = known_types().types
    for package, names in EQUIVALENTS.items():
        for name in names:
            assert (list(known[f"{package}/msg/{name}"].__dataclass_fields__)
                    == list(known[f"car_interface/msg/{name}"].__dataclass_fields__))


def test_autowares_messages_are_known_where_the_recording_has_no_definitions(tmp_path):
    lateral, longitudinal, control = (
        (f"autoware_control_msgs/{name}", (ROOT / "msg" / f"{name}.msg").read_text(encoding="utf-8"))
        for name in ("Lateral", "Longitudinal", "Control"))
    command = Written(0.0, "/cmd", "autoware_control_msgs/Control", {"longitudinal": {"acceleration": 0.5}})
    path = write_ros2(tmp_path / "a", [command], with_definitions=False, extra_types=[lateral, longitudinal, control])
    (recorded,) = read(str(path), ["cmd"])
    assert recorded.message.longitudinal.acceleration == 0.5
