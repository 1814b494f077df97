"""A recording as the drive that the fit of an ESC takes: its neutral, what is unknown of it, and what is no drive."""
import numpy as np
import pytest

from car_interface.common.errors import CarInterfaceError
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.tools.calibration.esc.drive import load_esc_drive, pulls
from car_interface.tools.recordings.recording import NoRecording
from written_recordings import Written, odometry, output, write_ros1

SHIPPED = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[3277, 4915, 6554], neutral=4915)
FALLING = ThrottleCalibration(channel=1, value_axis=[-5, 0, 3], duty_table=[6554, 4915, 3277], neutral=4915)
ONE_SIDED = ThrottleCalibration(channel=1, value_axis=[0, 3], duty_table=[4915, 6554], neutral=4915)
END_S = 10.0


def state(time_s, granted=0.0, duty=4915, esc_cause="calibration drive"):
    return Written(time_s, "/throttle_arb/state", "car_interface/ThrottleState",
                   {"granted": granted, "duty": duty, "esc_cause": esc_cause})


def outputs(*changes):
    """The board's output twice a second, and at each of (time, duty)."""
    found, duty = [], changes[0][1]
    for time_s in sorted({*(change[0] for change in changes), *np.arange(0.0, END_S, 0.5)}):
        duty = dict(changes).get(time_s, duty)
        found.append(output(time_s, 5100, duty))
    return found


def driven(tmp_path, messages, gap=(END_S, END_S), calibration=SHIPPED):
    """The drive of messages beside an odometry that has a gap."""
    odom = [odometry(time_s, x_m=time_s, speed_mps=1.0) for time_s in np.arange(0.0, END_S, 0.02)
            if not gap[0] < time_s < gap[1]]
    path = write_ros1(tmp_path / "a.bag", sorted([*odom, *messages], key=lambda message: message.time_s))
    return load_esc_drive(str(path), calibration)


def duty_at(drive, time_s):
    return drive.duty[np.searchsorted(drive.t_s, time_s, side="right") - 1]


def test_drive_has_the_duties_of_the_channel_and_the_ends_of_the_table(tmp_path):
    found = driven(tmp_path, [*outputs((0.0, 4912), (3.0, 5600), (5.0, 4912)), state(1.0)])
    drive = found.drive
    assert [duty_at(drive, time_s) for time_s in (1.0, 4.0, 6.0)] == [4912, 5600, 4912]
    assert (drive.neutral, drive.full_forward, drive.full_reverse, found.notes) == (4915, 6554, 3277, ())
    assert set(drive.speed_mps) == {1.0} and drive.wheels == ()


@pytest.mark.parametrize("calibration, states, neutral_and_ends", [
    (SHIPPED, [state(1.0, 0.0, 4940), state(2.0, 0.5, 5700)], (4940, 6579, 3302)),
    (FALLING, [state(1.0)], (4915, 6553, 3276)),
], ids=["that_of_the_drive_whatever_the_file_has", "mirrored_where_shorter_pulses_are_forward"])
def test_neutral_and_ends_are(tmp_path, calibration, states, neutral_and_ends):
    drive = driven(tmp_path, [*outputs((0.0, 4944), (3.0, 4200)), *states], calibration=calibration).drive
    assert (drive.neutral, drive.full_forward, drive.full_reverse) == neutral_and_ends
    assert duty_at(drive, 4.0) == (4200 if calibration is SHIPPED else 2 * 4915 - 4200)


def test_neutral_that_was_tuned_during_the_drive_is_refused(tmp_path):
    with pytest.raises(CarInterfaceError, match=r"servo/neutral was tuned during the drive \(it was 4900 to 4940\)"):
        driven(tmp_path, [*outputs((0.0, 4912)), *(state(time_s, 0.0, duty) for time_s, duty in
                                                   ((1.0, 4900), (1.1, 4900), (2.0, 4940)))])


@pytest.mark.once
@pytest.mark.parametrize("gap, known, unknown", [((4.0, 4.4), (4.2,), ()), ((4.0, 6.0), (3.9, 6.1), (4.1, 5.9))])
def test_where_odometry_is_missing_nothing_is_known_of_the_esc(tmp_path, gap, known, unknown):
    drive = driven(tmp_path, [*outputs((0.0, 4912), (5.0, 4000)), state(1.0)], gap).drive
    assert all(duty_at(drive, time_s) > 0 for time_s in known)
    assert all(np.isnan(duty_at(drive, time_s)) for time_s in unknown)
    assert duty_at(drive, 7.0) == 4000


def test_where_the_board_s_output_is_missing_nothing_is_known_of_the_esc(tmp_path):
    held = [output(time_s, 5100, duty) for time_s, duty in ((0.0, 4912), (1.0, 4000), (5.0, 4912), (6.0, 4912))]
    drive = driven(tmp_path, [*held, state(1.0)]).drive
    np.testing.assert_equal([duty_at(drive, time_s) for time_s in (3.4, 3.6, 4.9, 5.1)], [4000, np.nan, np.nan, 4912])


@pytest.mark.once
def test_duty_that_is_no_pulse_counts_as_none_and_without_throttle_arb_s_state_there_is_a_note(tmp_path):
    changes = ((0.0, 4912), (2.0, -1), (4.0, 0), (6.0, 65535), (8.0, 4912))
    found = driven(tmp_path, outputs(*changes))
    np.testing.assert_equal([duty_at(found.drive, time_s) for time_s in (1.0, 3.0, 5.0, 7.0, 9.0)],
                            [4912, np.nan, np.nan, np.nan, 4912])
    assert found.drive.neutral == 4915
    assert found.notes[0].endswith("has no throttle_arb/state: who drove, and whether by hand, isn't known")


def test_pull_with_which_a_recording_begins_follows_nothing_whatever_the_one_before_ended_with(tmp_path):
    drive = driven(tmp_path, [*outputs((0.0, 4000), (3.0, 4912)), state(1.0)]).drive
    (pull,) = pulls(drive)
    assert np.isinf(pull.since_forward_s) and not pull.follows_pull


@pytest.mark.once
@pytest.mark.parametrize("messages, calibration, error, said", [
    ([state(1.0)], SHIPPED, NoRecording, "has no topic /servo/output, which says what the ESC got"),
    ([*outputs((0.0, -1)), state(1.0)], SHIPPED, CarInterfaceError, "channel 1 of the servo board never had a pulse"),
    ([*outputs((0.0, 4912)), state(1.0, esc_cause="no throttle")], SHIPPED, CarInterfaceError,
     "was driven without calibration_drive"),
    ([*outputs((0.0, 4912)), state(1.0)], ONE_SIDED, CarInterfaceError,
     "servo/neutral 4915 is an end of servo/duty_table"),
], ids=["no_output", "no_pulse", "no_calibration_drive", "neutral_at_an_end"])
def test_recording_that_is_no_such_drive_is_refused(tmp_path, messages, calibration, error, said):
    with pytest.raises(error, match=said):
        driven(tmp_path, messages, calibration=calibration)
