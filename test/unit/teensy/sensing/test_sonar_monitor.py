"""Which sonars are alive: told by name within ten seconds, started again only when they are silent."""

import pytest

from captures import NS_PER_US, load
from car_interface.sim.teensy_firmware import FirmwareConfig, TeensyFirmware
from car_interface.sim.teensy_sensors import SONAR_FINE, SONAR_STUCK
from car_interface.teensy.link.framing import SHIPPED, FrameDecoder, encode
from car_interface.teensy.link.protocol import START_SONARS, Pong, SonarStatus, decode
from car_interface.teensy.sensing.sonar_monitor import SEND_SEQUENCE, SEND_START, SonarMonitor, describe

MS, S = 1_000_000, 1_000_000_000
ALL = (0, 1, 2, 3, 4, 5)
ROUND_NS = 55 * MS
AHEAD = (1, 0, 1, 2, 1, 4)


class Listener:
    """Follows a capture as the hub would: each record as it comes, commands and faults four times a second."""

    def __init__(self, capture, knows_commands=True):
        self.monitor = SonarMonitor()
        self.commands = []  # (s, command)
        self.faults = []  # (s, words), whenever they change
        decoder, next_ns = FrameDecoder(), 0
        starts_ns = [line["t_us"] * NS_PER_US for line in capture.commands
                     if line["host"] == "sonar_start" and knows_commands]
        self.monitor.opened(0)
        for t_us, data in capture.chunks():
            now_ns = t_us * NS_PER_US
            while starts_ns and starts_ns[0] <= now_ns:
                self.monitor.started(starts_ns.pop(0))
            for record in map(decode, decoder.feed(data)):
                self.monitor.frame(now_ns)
                if isinstance(record, SonarStatus):
                    self.monitor.report(record.sensor, record.echo_us, record.when, now_ns)
                elif isinstance(record, Pong):
                    self.monitor.tick(record.timestamp2, now_ns)
            if now_ns >= next_ns:
                next_ns = now_ns + S // 4
                self.judge(now_ns)

    def judge(self, now_ns):
        command = self.monitor.next_command(now_ns)
        if command:
            self.commands.append((now_ns / S, command))
        words = describe(self.monitor.faults(now_ns))[0]
        if words != (self.faults[-1][1] if self.faults else ""):
            self.faults.append((now_ns / S, words))

    def first(self, *parts):
        return next((at_s for at_s, words in self.faults if all(part in words for part in parts)), None)


@pytest.mark.once
@pytest.mark.parametrize("name", ["drive_reverse", "wrap"])
def test_sonars_that_run_are_never_started_and_never_blamed(name):
    listener = Listener(load(name))
    assert (listener.commands, listener.faults) == ([], [])


def test_sonars_that_all_are_silent_from_power_up_are_started_after_three_seconds_and_the_missing_one_is_named():
    listener = Listener(load("missing_sonars"))
    at_s, command = listener.commands[0]
    assert command == SEND_START and 3.0 <= at_s <= 4.5
    assert listener.first("no sonar reports", "1 SONAR_START") <= 10
    # In the capture a SONAR_START arrives at 14 s: from then on five report, and the first is told by name.
    named_s = listener.first("front_right does not report")
    assert 14 < named_s < 17
    assert not [at_s for at_s, _ in listener.commands if at_s > 14]


def test_starts_that_do_not_help_become_rare():
    monitor = SonarMonitor()
    starts_s = []
    for now_s in range(600):
        monitor.frame(now_s * S)
        if monitor.next_command(now_s * S) == SEND_START:
            starts_s.append(now_s)
    gaps_s = [after - before for before, after in zip(starts_s, starts_s[1:])]
    assert starts_s[0] == 3 and gaps_s == sorted(gaps_s) and max(gaps_s) == 60
    assert monitor.starts == len(starts_s)


def test_sonar_that_silences_all_others_is_named_and_then_left_out():
    """In the capture all go silent at front_left after 2.1 s, and again after a SONAR_START at 5.5 s."""
    capture = load("stuck_old")
    listener = Listener(capture, knows_commands=False)
    assert listener.commands[0][1] == SEND_START
    assert listener.first("front_left seems stuck high") <= 2.1 + 5
    # The capture ends soon; what follows is that nothing but wheels comes.
    end_ns = capture.duration_us * NS_PER_US
    for step in range(1, 8):
        listener.monitor.frame(end_ns + step * S)
        listener.judge(end_ns + step * S)
    assert listener.monitor.dropped == (2,)
    assert SEND_SEQUENCE in [command for _, command in listener.commands]


def test_port_that_was_opened_anew_is_told_the_sequence_once_something_comes():
    monitor = SonarMonitor(sequence=(0, 1))
    monitor.opened(0)
    monitor.frame(0)
    assert monitor.next_command(0) == SEND_SEQUENCE and monitor.next_command(MS) is None
    monitor.opened(S // 10)
    assert monitor.next_command(S // 10) is None
    monitor.frame(S // 5)
    assert monitor.next_command(S // 5) == SEND_SEQUENCE


def test_no_report_within_70_ms_of_a_start_is_trusted_however_many_have_come():
    monitor = SonarMonitor()
    monitor.opened(0)
    monitor.tick(1000, S)
    monitor.started(S + 30 * MS)
    # The first one was made 16 ms before: it was on its way.
    assert [monitor.report(0, 5000, 1030 + later_ms, S + 130 * MS)
            for later_ms in (-16, 20, 40, 60, 70, 71)] == [True] + [False] * 4 + [True]


def test_a_report_is_trusted_from_the_first_ms_of_a_teensy_on():
    monitor = SonarMonitor()
    monitor.rebooted(S)
    assert monitor.report(0, 5000, 0, S)


def with_suspect():
    """A monitor of sonars that stopped at the second one and were started; since then only the third one reports."""
    monitor = SonarMonitor()
    monitor.opened(0)
    monitor.report(0, 5000, 1000, S)
    monitor.started(S)  # they stopped at the next sonar, 1
    for tick in (1080, 1160, 1240):
        monitor.report(2, 10_000, tick, tick * MS)
    return monitor


@pytest.mark.parametrize("echo_us, is_trusted", [(9317, True), (9316, False)])
def test_echo_may_be_shorter_by_2_cm_and_the_way_while_another_pin_may_be_high(echo_us, is_trusted):
    monitor = with_suspect()
    monitor.update_speed(-1.0, 1240 * MS)
    assert monitor.report(2, echo_us, 1340, 1340 * MS) == is_trusted  # 5830 µs are a metre


def test_another_sequence_ends_the_doubt_in_shorter_echoes():
    monitor = with_suspect()
    monitor.sequence_set((2, 3), 1300 * MS)  # the suspect will never report
    assert monitor.report(2, 5000, 1340, 1340 * MS)


class Sonars:
    """Reports in a steady rhythm, of the sensors that are alive."""

    def __init__(self, monitor=None):
        self.monitor = monitor or SonarMonitor()
        self.now_ns = 1000 * S
        self.monitor.opened(self.now_ns)

    def run(self, seconds, sensors=ALL, echo_us=5000, zeros=()):
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns:
            for sensor in sensors:
                self.now_ns += ROUND_NS
                self.monitor.frame(self.now_ns)
                self.monitor.report(sensor, 0 if sensor in zeros else echo_us, self.tick, self.now_ns)
        return self

    def be_silent(self, seconds):
        for _ in range(round(seconds * 5)):
            self.now_ns += S // 5
            self.monitor.frame(self.now_ns)
        return self

    @property
    def tick(self):
        return self.now_ns // MS

    @property
    def words(self):
        return describe(self.monitor.faults(self.now_ns))[0]

    @property
    def command(self):
        return self.monitor.next_command(self.now_ns)


def test_those_that_fall_silent_are_named_within_two_seconds_with_what_to_do_and_forgiven_with_their_next_report():
    sonars = Sonars().run(2)
    assert sonars.words == ""
    sonars.run(0.5, sensors=(0, 1, 2, 3, 5))  # ten reports
    assert sonars.words == ""
    sonars.run(0.2, sensors=(0, 1, 2, 3, 5))  # more than two rounds
    assert sonars.words == "rear_middle does not report: it seems not to be connected"
    sonars.run(0.4)
    assert sonars.words == "" and sonars.command is None
    sonars.run(1, sensors=(0, 1, 2))
    words, next_step = describe(sonars.monitor.faults(sonars.now_ns))
    assert words.count("does not report") == 3 and next_step.count("Check its plug and wires") == 1


def test_stopped_sonars_are_neither_started_nor_missed_until_they_were_started():
    sonars = Sonars().run(1)
    sonars.monitor.stopped()
    sonars.be_silent(100)
    assert sonars.command is None and sonars.words == ""
    sonars.monitor.started(sonars.now_ns)
    assert sonars.be_silent(2.8).command is None
    assert sonars.be_silent(0.4).command == SEND_START


def test_nothing_is_started_on_a_line_on_which_nothing_comes():
    sonars = Sonars().run(1)
    sonars.now_ns += 100 * S
    assert sonars.command is None and sonars.words == ""
    assert sonars.be_silent(2.5).command is None, "the Teensy has just come back"
    assert sonars.be_silent(1.0).command == SEND_START


def test_restart_can_be_turned_off_and_a_long_wait_between_pings_is_not_taken_for_silence():
    assert Sonars(SonarMonitor(restart_s=0)).be_silent(100).command is None
    sonars = Sonars().run(1)
    sonars.monitor.wait_set(5000)
    assert sonars.be_silent(9.8).command is None
    assert sonars.be_silent(0.4).command == SEND_START


def test_two_zeros_name_a_sonar_and_the_third_drops_it():
    sonars, suspected = Sonars(), "rear_right seems stuck high: it holds the other sonars up"
    for words, command in (("", None), (suspected, None), (suspected, SEND_SEQUENCE)):
        sonars.run(0.33, zeros=(3,))  # one round
        assert (sonars.words, sonars.command) == (words, command)
    assert sonars.monitor.sequence == (0, 1, 2, 4, 5)
    sonars.run(1, sensors=(0, 1, 2, 4, 5))
    assert sonars.words == "rear_right is stuck high and was taken out of the sequence"
    assert sonars.command is None


def test_zero_around_a_wrap_of_micros_blames_nobody():
    sonars = Sonars()
    sonars.now_ns = 4_294_967 * MS - 20 * MS
    for sensor in (1, 1, 1, 1):
        sonars.now_ns += 5 * MS
        sonars.monitor.frame(sonars.now_ns)
        sonars.monitor.report(sensor, 0, sonars.tick, sonars.now_ns)
    assert sonars.command is None and sonars.words == ""


def test_sonar_that_was_dropped_comes_back_with_a_new_sequence_or_a_reboot():
    for revive in (lambda monitor, now_ns: monitor.sequence_set(ALL, now_ns), SonarMonitor.rebooted):
        sonars = Sonars().run(1.5, zeros=(3,))
        assert sonars.command == SEND_SEQUENCE
        revive(sonars.monitor, sonars.now_ns)
        assert sonars.run(1).words == "" and sonars.monitor.dropped == () and sonars.monitor.sequence == ALL


DISCONNECTED = "rear_middle does not report: it seems not to be connected"


def test_sonars_that_all_are_silent_are_a_fault_at_each_moment_from_the_first_start_in_vain_to_the_first_report():
    sonars, words = Sonars(), []
    sonars.monitor.frame(sonars.now_ns)
    for _ in range(60 * 5):
        sonars.be_silent(0.2)
        if sonars.command == SEND_START and sonars.monitor.starts == 2:
            sonars.monitor.rebooted(sonars.now_ns)
        words.append(sonars.words)
    told = next(index for index, each in enumerate(words) if each)
    assert told <= 5 * 5
    assert all(each.startswith("no sonar reports") for each in words[told:])
    assert sonars.run(0.4).words == ""


@pytest.mark.parametrize("event", [
    SonarMonitor.rebooted, SonarMonitor.opened, SonarMonitor.started,
    lambda monitor, now_ns: monitor.sequence_set(ALL, now_ns)],
    ids=["reboot", "port", "start", "sequence"])
def test_fault_stays_until_its_sonar_reports_whatever_happens_to_the_others(event):
    sonars = Sonars().run(1.5, sensors=(0, 1, 2, 3, 5))
    assert sonars.words == DISCONNECTED
    event(sonars.monitor, sonars.now_ns)
    sonars.monitor.frame(sonars.now_ns)
    assert sonars.words == DISCONNECTED
    assert sonars.run(1.5, sensors=(0, 1, 2, 3, 5)).words == DISCONNECTED
    assert sonars.run(0.3).words == ""


def test_stuck_sonar_stays_a_suspect_over_a_reboot_and_is_left_out_by_its_next_zero():
    sonars = Sonars().run(1.5, zeros=(3,))
    assert sonars.command == SEND_SEQUENCE
    sonars.monitor.rebooted(sonars.now_ns)
    sonars.monitor.frame(sonars.now_ns)
    assert sonars.words == "rear_right seems stuck high: it holds the other sonars up"
    assert sonars.command is None and sonars.monitor.sequence == ALL
    sonars.run(0.33, zeros=(3,))
    assert sonars.command == SEND_SEQUENCE and sonars.monitor.dropped == (3,)


def test_sonar_at_which_all_stop_stays_a_suspect_over_a_reboot_and_is_left_out_by_its_next_stall():
    def stall():
        sonars.run(0.1, sensors=(0, 1)).be_silent(3.2)
        return sonars.command

    sonars = Sonars()
    assert [stall(), stall(), sonars.command] == [SEND_START, SEND_START, SEND_SEQUENCE]
    sonars.monitor.rebooted(sonars.now_ns)
    sonars.run(0.1, sensors=(0, 1))
    assert sonars.words == "front_left seems stuck high: it holds the other sonars up"
    assert sonars.command is None and sonars.monitor.sequence == ALL
    assert [stall(), sonars.command] == [SEND_START, SEND_SEQUENCE] and sonars.monitor.dropped == (2,)


def reports_around_release(released_ms, speed_mps=0.0, wall_us=lambda sensor, at_ns: 10_000):
    """Return (sensor, µs, trusted) of each report of a Teensy whose stuck pin is released at a time after SONAR_START.

    It has run for so long that its sonars stop at a stuck one.
    """
    teensy = TeensyFirmware(FirmwareConfig(clock_start_ms=200_000, seed=1), wall_us)
    monitor, decoder, now_ns, started_ns, found = SonarMonitor(restart_s=0.6), FrameDecoder(), 0, None, []
    monitor.opened(0)
    monitor.update_speed(speed_mps, 0)
    while started_ns is None or now_ns < started_ns + S:
        now_ns += MS
        if now_ns == S:
            teensy.set_sonar(2, SONAR_STUCK, now_ns)
        if started_ns is not None and now_ns == started_ns + released_ms * MS:
            teensy.set_sonar(2, SONAR_FINE, now_ns)
        for record in map(decode, decoder.feed(teensy.transmit(now_ns))):
            monitor.frame(now_ns)
            if isinstance(record, SonarStatus):
                trusted = monitor.report(record.sensor, record.echo_us, record.when, now_ns)
                found.append((record.sensor, record.echo_us, trusted))
        if started_ns is None and monitor.next_command(now_ns) == SEND_START:
            started_ns = now_ns
            teensy.receive(encode(START_SONARS, SHIPPED), now_ns)
    return found


@pytest.mark.once
def test_released_pin_ends_another_sonars_echo_and_that_one_is_distrusted():
    cut = 0
    for released_ms in range(150, 330, 5):
        for sensor, echo_us, trusted in reports_around_release(released_ms):
            if sensor != 2 and abs(echo_us - 9_987) > 100:
                cut += 1
                assert not trusted, (released_ms, sensor, echo_us)
    assert cut >= 3


def test_pin_that_stays_stuck_costs_no_range_of_a_wall_that_a_moving_car_comes_nearer_to():
    found = reports_around_release(2000, 2.0, lambda sensor, at_ns: 11_000 - 5_830 * at_ns * 0.5 / S)
    start = 1 + max(i for i, (sensor, _, _) in enumerate(found[:-3]) if sensor == 1)
    assert [trusted for _, _, trusted in found[:start]] == start * [True]
    assert [trusted for _, _, trusted in found][-3:] == 3 * [True]


def test_clone_is_told_with_the_parameter_that_it_needs_and_beside_it_for_ten_seconds_a_pin_that_blinked():
    sonars = Sonars().run(1)
    sonars.monitor.clones = {2: 200.004}
    sonars.monitor.blinked[1] = sonars.now_ns
    words, next_step = describe(sonars.monitor.faults(sonars.now_ns))
    assert "front_middle's echo pin was high for over a second" in words
    assert "Check its echo wire and supply" in next_step and "~no_echo_timeouts/front_left to 200" in next_step
    sonars.run(11)
    assert sonars.words == "front_left is a clone that holds its pulse for 200 ms without an echo: its ranges are right"


def test_last_sonar_of_the_sequence_is_never_dropped():
    sonars = Sonars()
    sonars.monitor.sequence_set((2,), sonars.now_ns)
    sonars.run(3, sensors=(2,), zeros=(2,))
    assert sonars.command is None and "front_left seems stuck high" in sonars.words


def aimed(ahead=AHEAD, sequence=()):
    """A monitor of a car that drives forward since 0.1 s, and what it sent for that."""
    monitor = SonarMonitor(3.0, sequence, ahead)
    monitor.opened(0)
    monitor.frame(0)
    monitor.next_command(0)
    assert monitor.next_command(0) is None and monitor.sequence == tuple(sequence or ALL)
    monitor.update_speed(1.0, S // 10)
    return monitor, monitor.next_command(S // 10)


def test_while_the_car_drives_forward_the_sonars_ahead_fire_most_and_afterwards_all_do():
    monitor, command = aimed()
    assert command == SEND_SEQUENCE and monitor.sequence == AHEAD
    assert monitor.next_command(S // 10) is None
    monitor.update_speed(0.0, S // 2)  # a short stop
    assert monitor.next_command(S // 2) is None
    monitor.frame(2 * S)
    monitor.update_speed(0.0, 2 * S)
    assert monitor.next_command(2 * S) == SEND_SEQUENCE and monitor.sequence == ALL


@pytest.mark.parametrize("requested, usual", [(None, (1, 4)), ([0, 1], (0, 1))])
def test_a_car_that_begins_to_reverse_has_its_usual_or_newly_requested_sequence_at_once(requested, usual):
    monitor, _ = aimed(sequence=[1, 4])
    if requested:
        monitor.sequence_set(requested, S // 6)
        assert monitor.sequence == usual
    monitor.update_speed(-0.3, S // 5)
    assert monitor.next_command(S // 5) == SEND_SEQUENCE and monitor.sequence == usual


@pytest.mark.parametrize("event", [SonarMonitor.rebooted, SonarMonitor.opened])
def test_a_teensy_that_reboots_or_a_port_that_is_opened_again_on_the_way_gets_it_again(event):
    monitor, _ = aimed()
    event(monitor, S // 5)
    assert monitor.sequence == (ALL if event == SonarMonitor.rebooted else AHEAD)
    monitor.frame(S // 5)
    assert monitor.next_command(S // 5) == SEND_SEQUENCE and monitor.sequence == AHEAD


@pytest.mark.parametrize("speeds, is_ahead", [
    ([], False), ([(0.0, 0.14)], False), ([(0.0, 0.16)], True),
    ([(0.0, 0.5), (0.9, 0.0)], True), ([(0.0, 0.5), (1.1, 0.0)], False),  # stopped just now, for a second
    ([(0.0, 0.5), (0.1, -0.09)], True), ([(0.0, 0.5), (0.1, -0.11)], False),  # reverses
    ([(5.0, -0.2), (5.1, 0.05)], False),
])
def test_sonars_fire_ahead_while_the_car_drives_forward(speeds, is_ahead):
    monitor, now_ns = SonarMonitor(ahead=AHEAD), 0
    for at_s, speed_mps in speeds:
        now_ns = round(at_s * S)
        monitor.update_speed(speed_mps, now_ns)
    monitor.frame(now_ns)
    assert monitor.next_command(now_ns) == (SEND_SEQUENCE if is_ahead else None)
    assert monitor.sequence == (AHEAD if is_ahead else ALL)
