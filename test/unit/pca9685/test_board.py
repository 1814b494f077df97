"""The driver of the PCA9685 over a bus: what it writes, in which order, how little, and what it knows afterwards."""
from __future__ import annotations

import errno

import pytest

from car_interface.pca9685.board import Board, BoardMismatch, ForeignWrite
from car_interface.pca9685.channels import differences
from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685

ADDRESS = 0x40
MODE1, MODE2, LED0_ON_L, PRE_SCALE = 0x00, 0x01, 0x06, 0xFE
SLEEP, AUTO_INCREMENT = 0x10, 0x20
PRESCALE_50_HZ = 121
CENTER = 319  # counts


class Bench:
    """A chip on a virtual bus that writes a log: ("write", register, data) and ("pause", seconds)."""

    def __init__(self):
        self.chip = VirtualPca9685()
        self.log = []
        self.reads = []  # (register, length) of each block
        self.transfers = []  # bytes on the wire of each write, address and register included
        self._bus = VirtualBus({ADDRESS: self.chip},
                               on_write=lambda address, register, data: self.transfers.append(2 + len(data)))
        self.board = self.another_board()

    def another_board(self, prescale=PRESCALE_50_HZ):
        return Board(self, ADDRESS, prescale, 25e6, lambda seconds: self.log.append(("pause", seconds)))

    def read_byte_data(self, address, register):
        return self._bus.read_byte_data(address, register)

    def read_i2c_block_data(self, address, register, length):
        self.reads.append((register, length))
        return self._bus.read_i2c_block_data(address, register, length)

    def write_byte_data(self, address, register, value):
        self._note(register, [value])
        self._bus.write_byte_data(address, register, value)

    def write_i2c_block_data(self, address, register, data):
        self._note(register, data)
        self._bus.write_i2c_block_data(address, register, data)

    def _note(self, register, data):
        """Log a write; see that none puts the chip to sleep while a pin may still be in the middle of a pulse."""
        goes_to_sleep = register == MODE1 and data[0] & SLEEP and not self.chip.read(MODE1, 1)[0] & SLEEP
        if goes_to_sleep:
            assert self.high_counts() == [0] * 16
            written_last = max(index for index, entry in enumerate(self.log) if entry[0] == "write")
            paused_s = sum(entry[1] for entry in self.log[written_last + 1:])
            assert paused_s >= self.chip.period_s(oscillator_hz=23e6)
            assert paused_s < 0.05
        self.log.append(("write", register, list(data)))

    def high_counts(self):
        return [self.chip.high_counts(channel) for channel in range(16)]

    def writes(self):
        return [entry[1:] for entry in self.log if entry[0] == "write"]


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def running(bench):
    """A bench whose board is initialised and whose log is empty."""
    bench.board.initialise()
    bench.log.clear()
    bench.transfers.clear()
    return bench


def test_board_before_anything_was_written_knows_of_no_channel(bench):
    assert bench.board.held == [None] * 16


def test_period_of_the_board_is_that_of_its_prescale(bench):
    assert bench.board.period_s == pytest.approx(1 / 50.03, rel=1e-3)
    assert bench.another_board(prescale=30).period_s == pytest.approx(1 / 196.9, rel=1e-3)


def test_chip_after_power_up_is_initialised_awake_at_its_frequency_with_every_channel_off(bench):
    bench.board.initialise()
    assert bench.chip.read(MODE1, 1) == [AUTO_INCREMENT]
    assert bench.chip.read(MODE2, 1) == [0x04]
    assert bench.chip.read(PRE_SCALE, 1) == [PRESCALE_50_HZ]
    assert bench.high_counts() == [0] * 16
    assert bench.board.held == [0] * 16


def test_oscillator_is_given_500_us_to_start(bench):
    bench.board.initialise()
    assert bench.log[-1] == ("pause", 500e-6)
    assert bench.log[-2] == ("write", MODE1, [AUTO_INCREMENT])


@pytest.mark.parametrize("old_prescale", [3, 30, 122, 255])
def test_chip_that_runs_at_another_frequency_is_stopped_for_a_whole_period_before_it_sleeps(bench, old_prescale):
    bench.another_board(old_prescale).initialise()
    bench.board.write({0: CENTER, 7: 4096})
    bench.log.clear()
    bench.board.initialise()  # Bench._note asserts it
    assert bench.chip.read(PRE_SCALE, 1) == [PRESCALE_50_HZ]
    assert bench.high_counts() == [0] * 16
    assert bench.board.held == [0] * 16


def test_chip_that_already_runs_so_is_neither_put_to_sleep_nor_interrupted(running):
    running.board.write({0: CENTER, 1: 4096})
    running.log.clear()
    board = running.another_board()
    board.initialise()
    assert running.high_counts()[:2] == [CENTER, 4096]
    assert running.writes() == [(MODE1, [AUTO_INCREMENT]), (MODE2, [0x04])]
    assert board.held == [CENTER, 4096] + [0] * 14  # what is published before the first write


def test_chip_that_runs_without_auto_increment_gets_it(running):
    running.chip.write(MODE1, [0])
    running.another_board().initialise()
    assert running.chip.read(MODE1, 1) == [AUTO_INCREMENT]


def test_chip_that_runs_and_answers_all_call_goes_on_running_and_stops_answering(running):
    running.board.write({0: CENTER})
    running.chip.write(MODE1, [AUTO_INCREMENT | 0x01])
    running.log.clear()
    running.another_board().initialise()
    assert running.high_counts()[0] == CENTER
    assert running.writes() == [(MODE1, [AUTO_INCREMENT]), (MODE2, [0x04])]


def test_chip_asleep_needs_no_wait_for_pulses_to_end(bench):
    bench.board.initialise()
    assert [entry for entry in bench.log if entry[0] == "pause"] == [("pause", 500e-6)]


def test_chip_asleep_with_inverted_outputs_gets_them_upright(bench):
    bench.chip.write(MODE2, [0x10])
    bench.board.initialise()
    assert bench.chip.read(MODE2, 1) == [0x04]


def test_chip_put_to_sleep_with_pulses_by_another_program_does_not_bring_them_back(running):
    running.board.write({0: 4000})
    running.chip.write(MODE1, [AUTO_INCREMENT | SLEEP])
    board = running.another_board()
    board.initialise()
    assert running.chip.read(MODE1, 1) == [AUTO_INCREMENT]
    assert running.high_counts() == [0] * 16
    board.write({0: CENTER})
    assert running.high_counts()[0] == CENTER


@pytest.mark.parametrize("channel", [0, 8, 15])
def test_change_of_one_channel_is_one_transfer_of_six_bytes(running, channel):
    running.board.write({channel: CENTER})
    assert running.writes() == [(LED0_ON_L + 4 * channel, [0x00, 0x00, 0x3F, 0x01])]
    assert running.transfers == [6]
    assert running.high_counts()[channel] == CENTER
    assert running.board.held[channel] == CENTER


def test_change_of_all_channels_is_two_transfers_of_34_bytes(running):
    changes = {channel: 100 + channel for channel in range(16)}
    running.board.write(changes)
    assert running.transfers == [34, 34]
    assert running.high_counts() == list(changes.values())
    assert running.board.held == list(changes.values())


def test_change_of_distant_channels_leaves_those_between_alone(running):
    running.board.write({1: 10, 2: 20, 9: 90})
    assert running.transfers == [10, 6]
    assert running.high_counts() == [0, 10, 20, 0, 0, 0, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0]


def test_channels_that_did_not_change_cost_nothing(running):
    running.board.write({0: CENTER})
    running.transfers.clear()
    running.board.write(differences(running.board.held, [CENTER] + [0] * 15))
    assert running.transfers == []


@pytest.mark.parametrize("counts, high, registers", [
    pytest.param(0, 0, [0, 0, 0, 0x10], id="none_is_the_full_off_bit"),
    pytest.param(4096, 4096, [0, 0x10, 0, 0], id="all_is_the_full_on_bit"),
    pytest.param(4095, 4095, [0, 0, 0xFF, 0x0F], id="one_less_is_a_pulse"),
])
def test_ends_of_the_range_are_written_as_bits(running, counts, high, registers):
    running.board.write({0: 4096 - counts})
    running.board.write({0: counts})
    assert running.high_counts()[0] == high
    assert running.chip.read(LED0_ON_L, 4) == registers


def test_all_off_is_one_transfer_and_does_not_sleep(running):
    running.board.write({0: CENTER, 5: 4096})
    running.transfers.clear()
    running.log.clear()
    running.board.all_off()
    assert running.writes() == [(0xFD, [0x10])]
    assert running.transfers == [3]
    assert running.high_counts() == [0] * 16
    assert running.board.held == [0] * 16
    assert not running.chip.read(MODE1, 1)[0] & SLEEP


def test_check_of_a_chip_that_holds_what_was_written_changes_nothing(running):
    running.board.write({0: CENTER, 7: 4096})
    held = running.board.held
    running.log.clear()
    for _ in range(8):
        running.board.check()
    assert running.board.held == held
    assert running.log == []


@pytest.mark.parametrize("channel, checks", [
    pytest.param(0, 1, id="a_channel_that_is_on_in_the_next_check"),
    pytest.param(2, 1, id="one_of_the_first_four_that_are_off_in_the_next_check"),
    pytest.param(15, 4, id="the_last_one_that_is_off_in_the_fourth_check"),
])
def test_foreign_write_is_found_and_known(running, channel, checks):
    running.board.write({0: CENTER, 1: 307})
    written = {0: CENTER, 1: 307}.get(channel, 0)
    running.chip.write(LED0_ON_L + 4 * channel, [0, 0, 0x10, 0x01])
    for _ in range(checks - 1):
        running.board.check()
    with pytest.raises(ForeignWrite, match=f"^channel {channel} holds 272 counts, not {written}$"):
        running.board.check()
    assert running.board.held[channel] == 272
    running.board.check()


def test_check_reads_what_is_on_and_four_of_the_others_so_that_a_command_waits_for_3_ms_at_most(running):
    running.board.write({0: CENTER, 1: 307})
    for _ in range(5):
        running.reads.clear()
        running.board.check()
        assert sum(length for _, length in running.reads) == 4 * (2 + 4)


def test_chip_that_lost_its_power_is_a_mismatch_and_no_foreign_write(running):
    running.board.write({0: CENTER})
    running.chip.power_up()
    with pytest.raises(BoardMismatch, match="MODE1 is 0x11") as caught:
        running.board.check()
    assert not isinstance(caught.value, ForeignWrite)


def test_read_back_learns_what_another_program_wrote(running):
    running.chip.write(0xFD, [0x00])
    running.chip.write(LED0_ON_L + 4 * 9, [0, 0x10, 0, 0])
    running.board.read_back()
    assert running.board.held == [0] * 9 + [4096] + [0] * 6


def test_list_of_what_is_held_is_a_copy(running):
    running.board.held[0] = 1234
    assert running.board.held[0] == 0


class FailingBus(VirtualBus):
    """A bus whose n-th transfer from now, counted from 0, is not acknowledged; and each one after it."""

    def __init__(self, chip):
        self.transfers = []
        super().__init__({ADDRESS: chip},
                         on_write=lambda address, register, data: self.transfers.append(2 + len(data)))
        self.works_for = None

    def _chip(self, address):
        if self.works_for is not None:
            if self.works_for == 0:
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            self.works_for -= 1
        return super()._chip(address)


@pytest.fixture
def failing():
    bus = FailingBus(VirtualPca9685())
    board = Board(bus, ADDRESS, PRESCALE_50_HZ, 25e6, lambda seconds: None)
    board.initialise()
    board.write(dict.fromkeys(range(16), CENTER))
    return bus, board


def test_write_not_acknowledged_leaves_its_channels_unknown_and_the_others_known(failing):
    bus, board = failing
    bus.works_for = 0
    with pytest.raises(OSError, match="Remote I/O error"):
        board.write({3: 100, 4: 100})
    assert board.held == [CENTER] * 3 + [None] * 2 + [CENTER] * 11


def test_second_block_not_acknowledged_leaves_the_first_known(failing):
    bus, board = failing
    bus.works_for = 1
    with pytest.raises(OSError, match="Remote I/O error"):
        board.write(dict.fromkeys(range(16), 100))
    assert board.held == [100] * 8 + [None] * 8


def test_write_after_a_failure_writes_what_is_unknown_even_to_its_old_value(failing):
    bus, board = failing
    bus.works_for = 0
    with pytest.raises(OSError, match="Remote I/O error"):
        board.write({3: 100})
    bus.works_for = None
    board.write(differences(board.held, [CENTER] * 16))
    assert bus.transfers[-1] == 6
    assert board.held == [CENTER] * 16


def test_all_off_not_acknowledged_leaves_every_channel_unknown(failing):
    bus, board = failing
    bus.works_for = 0
    with pytest.raises(OSError, match="Remote I/O error"):
        board.all_off()
    assert board.held == [None] * 16


@pytest.mark.parametrize("works_for", range(12))
def test_initialisation_that_fails_at_any_transfer_passes_the_error_on_and_can_be_repeated(works_for):
    bus = FailingBus(VirtualPca9685())
    Board(bus, ADDRESS, 122, 25e6, lambda seconds: None).initialise()
    board = Board(bus, ADDRESS, PRESCALE_50_HZ, 25e6, lambda seconds: None)
    bus.works_for = works_for
    with pytest.raises(OSError, match="Remote I/O error"):
        board.initialise()
    bus.works_for = None
    board.initialise()
    board.write({0: CENTER})
    assert bus._chip(ADDRESS).high_counts(0) == CENTER
    assert bus._chip(ADDRESS).read(PRE_SCALE, 1) == [PRESCALE_50_HZ]


def test_chip_at_another_address_is_not_found(bench):
    board = Board(bench, 0x41, PRESCALE_50_HZ, 25e6, lambda seconds: None)
    with pytest.raises(OSError, match="Remote I/O error"):
        board.initialise()
