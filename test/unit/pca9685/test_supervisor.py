"""Keeping a board alive: one repetition, then back-off and a new start, and a chip that forgot is told again."""

import pytest
from virtual_bus import VirtualBus

from car_interface.pca9685 import supervisor as events
from car_interface.pca9685.board import Board, BoardMismatch
from car_interface.pca9685.supervisor import BoardSupervisor
from car_interface.sim.pca9685_chip import VirtualPca9685

MS = 1_000_000
NOW = 1000_000 * MS
ADDRESS = 0x40
NEUTRAL = [319] + [0] * 15
LEFT = [238] + [0] * 15


class Bench:
    def __init__(self):
        self.chip = VirtualPca9685()
        self.bus = VirtualBus({ADDRESS: self.chip}, on_write=lambda *write: self.writes.append(write))
        self.bus.close = self._close
        self.writes = []
        self.events = []
        self.opened = self.closed = 0
        self.open_error = None
        self.on_event = self.events.append
        self.supervisor = self.another_supervisor()
        self.now_ns = NOW

    def another_supervisor(self):
        return BoardSupervisor(self._open, lambda event, error: self.on_event(event))

    def _open(self):
        if self.open_error is not None:
            raise self.open_error
        self.opened += 1
        return Board(self.bus, ADDRESS, 121, lambda seconds: None)

    def _close(self):
        self.closed += 1

    def update(self, targets, after_ms=0):
        self.now_ns += after_ms * MS
        self.supervisor.update(targets if callable(targets) else lambda: targets, self.now_ns)

    def update_when_due(self, targets):
        """Go on until an update is due; how many ms that took."""
        waited_ns = self.supervisor.next_due_ns() - self.now_ns
        self.update(targets, waited_ns // MS)
        return waited_ns // MS

    def pulses(self):
        return [self.chip.high_counts(channel) for channel in range(16)]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def running(bench):
    bench.update(NEUTRAL)
    assert bench.events == [events.FOUND, events.RUNNING] and bench.supervisor.running
    assert bench.pulses() == bench.supervisor.held == NEUTRAL
    bench.events.clear()
    bench.writes.clear()
    return bench


def test_what_did_not_change_is_not_written_and_the_chip_is_read_twice_a_second(running):
    for targets in (NEUTRAL, LEFT, LEFT):
        running.update(targets, 1)
    assert len(running.writes) == 1 and running.pulses() == LEFT
    assert [running.update_when_due(LEFT) for _ in range(5)] == [497, *[500] * 4]
    assert len(running.writes) == 1 and running.events == []


def test_two_failures_close_the_bus_which_is_opened_again_after_100_ms_with_the_newest_target(running):
    running.bus.nacks_left = 2
    running.update(LEFT, 1)
    assert running.events == [events.RETRIED, events.DISCONNECTED] and running.supervisor.errors == 2
    assert running.supervisor.held == [None] * 16 and running.closed == 1
    running.update(NEUTRAL, 99)
    assert not running.supervisor.running
    running.update(NEUTRAL, 1)
    assert running.supervisor.running and running.pulses() == NEUTRAL
    assert running.supervisor.reopenings == 1
    running.bus.nacks_left = 2
    running.update(LEFT, 1)
    running.supervisor.retry_now()  # or at once, where that is asked for
    running.update(LEFT)
    assert running.pulses() == LEFT


def test_pauses_between_attempts_double_to_2_s_until_the_board_was_there_and_are_100_ms_from_then_on(bench):
    bench.bus.chips.pop(ADDRESS)
    bench.update(NEUTRAL)
    assert [bench.update_when_due(NEUTRAL) for _ in range(7)] == [100, 200, 400, 800, 1600, 2000, 2000]
    assert bench.events == [events.ABSENT] * 8 and bench.supervisor.errors == 8
    assert not bench.supervisor.ever_ran
    bench.bus.chips[ADDRESS] = bench.chip
    bench.update_when_due(NEUTRAL)
    assert bench.supervisor.running
    bench.bus.chips.pop(ADDRESS)
    bench.update(LEFT, 1)
    assert [bench.update_when_due(LEFT) for _ in range(3)] == [100, 100, 100]  # it may go on pulsing
    assert bench.supervisor.ever_ran


def test_what_the_chip_holds_is_known_before_it_is_written_anew(running):
    found = []
    running.on_event = lambda event: found.append((event, running.supervisor.held))
    running.chip.power_up()
    running.update_when_due(NEUTRAL)
    assert found == [(events.MISMATCH, NEUTRAL), (events.FOUND, [0] * 16)] and running.pulses() == NEUTRAL
    assert running.supervisor.reinitialisations == 1
    running.update(LEFT, 1)
    running.supervisor = running.another_supervisor()
    found.clear()
    running.update(NEUTRAL, 1)
    assert found == [(events.FOUND, LEFT), (events.RUNNING, NEUTRAL)]


def test_channel_that_another_program_wrote_is_reported_and_written_anew_or_known_after_reading_back(running):
    running.chip.write(0x06, [0, 0, 0, 0x08])
    running.update_when_due(NEUTRAL)
    assert running.events == [events.FOREIGN]
    assert running.pulses() == NEUTRAL
    assert running.supervisor.foreign_writes == 1
    running.chip.write(0x06, [0, 0, 0, 0x08])
    running.supervisor.read_back(running.now_ns)
    assert running.supervisor.held == [2048] + [0] * 15
    running.bus.nacks_left = 2
    running.supervisor.read_back(running.now_ns)
    assert not running.supervisor.running
    running.supervisor.read_back(running.now_ns)


def test_repetition_after_a_failure_writes_what_is_wanted_by_then(running):
    wanted = [LEFT]

    def fail_slowly(register, data, write=running.chip.write):
        wanted[0] = NEUTRAL[:1] + [307] + [0] * 14  # it took so long that the command has expired
        running.chip.write = write
        raise TimeoutError(110, "Connection timed out")
    running.chip.write = fail_slowly
    running.update(lambda: wanted[0], 1)
    assert running.events == [events.RETRIED]
    assert running.pulses() == wanted[0]
    assert LEFT[0] not in [write[2][2] + 256 * write[2][3] for write in running.writes]


def test_chip_that_does_not_keep_its_prescale_counts_as_absent(bench):
    bench.chip.write = lambda register, data: None
    bench.update(NEUTRAL)
    assert bench.events == [events.ABSENT]
    with pytest.raises(BoardMismatch, match="MODE1 is 0x11 and PRE_SCALE 30, not 0x20 and 121"):
        bench.supervisor.open(lambda: NEUTRAL, NOW)


def test_all_off_is_repeated_once_and_tells_whether_it_worked(running):
    running.bus.nacks_left = 1
    assert running.supervisor.all_off(NOW)
    assert running.pulses() == [0] * 16
    running.bus.nacks_left = 2
    assert not running.supervisor.all_off(NOW)
    assert not running.supervisor.all_off(NOW)


def test_close_closes_the_bus_once_and_without_one_does_nothing(running):
    running.another_supervisor().close()
    assert running.closed == 0
    running.supervisor.close()
    running.supervisor.close()
    assert running.closed == 1
