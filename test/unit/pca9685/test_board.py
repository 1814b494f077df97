"""The driver of the PCA9685 over a bus: what it writes, in which order, how little, and what it knows afterwards."""

import errno

import pytest
from virtual_bus import VirtualBus

from car_interface.pca9685.board import Board, BoardMismatch, ForeignWrite
from car_interface.pca9685.channels import differences
from car_interface.sim.pca9685_chip import VirtualPca9685

ADDRESS = 0x40
MODE1, MODE2, LED0_ON_L, PRE_SCALE, ALL_LED_OFF_H = 0x00, 0x01, 0x06, 0xFE, 0xFD
SLEEP, AUTO_INCREMENT = 0x10, 0x20
PRESCALE_50_HZ = 121
CENTER = 319  # counts


class Bench:
    """A chip on a virtual bus that writes a log: ("write", register, data) and ("pause", seconds).

    After ``works_for`` transfers no other is acknowledged.
    """

    def __init__(self):
        self.chip = VirtualPca9685()
        self.log = []
        self.reads = []  # (register, length) of each
        self.transfers = []  # bytes on the wire of each write, address and register included
        self.works_for = None
        self._bus = VirtualBus({ADDRESS: self.chip},
                               on_write=lambda address, register, data: self.transfers.append(2 + len(data)))
        self.board = self.another_board()

    def another_board(self, prescale=PRESCALE_50_HZ):
        return Board(self, ADDRESS, prescale, lambda seconds: self.log.append(("pause", seconds)))

    def read_i2c_block_data(self, address, register, length):
        self._count()
        self.reads.append((register, length))
        return self._bus.read_i2c_block_data(address, register, length)

    def write_i2c_block_data(self, address, register, data):
        self._note(register, data)
        self._bus.write_i2c_block_data(address, register, data)

    def _count(self):
        if self.works_for is not None:
            if not self.works_for:
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            self.works_for -= 1

    def _note(self, register, data):
        """Log a write; see that none puts the chip to sleep while a pin may still be in the middle of a pulse."""
        self._count()
        goes_to_sleep = register == MODE1 and data[0] & SLEEP and not self.chip.read(MODE1, 1)[0] & SLEEP
        if goes_to_sleep:
            assert self.high_counts() == [0] * 16
            written_last = max(index for index, entry in enumerate(self.log) if entry[0] == "write")
            paused_s = sum(entry[1] for entry in self.log[written_last + 1:])
            assert 4096 * (self.chip.read(PRE_SCALE, 1)[0] + 1) / 23e6 <= paused_s < 0.05
        self.log.append(("write", register, list(data)))

    def high_counts(self):
        return [self.chip.high_counts(channel) for channel in range(16)]

    def writes(self):
        return [entry[1:] for entry in self.log if entry[0] == "write"]

    def registers(self):
        return [self.chip.read(register, 1)[0] for register in (MODE1, MODE2, PRE_SCALE)]


RUNNING = [AUTO_INCREMENT, 0x04, PRESCALE_50_HZ]


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


def test_chip_asleep_is_woken_at_its_frequency_with_every_channel_off_and_upright_outputs(bench):
    bench.chip.write(MODE2, [0x10])  # inverted by another program
    assert bench.board.held == [None] * 16
    bench.board.initialise()
    assert bench.registers() == RUNNING
    assert bench.high_counts() == bench.board.held == [0] * 16
    assert bench.log[-2:] == [("write", MODE1, [AUTO_INCREMENT]), ("pause", 500e-6)]  # for the oscillator to start
    assert sum(entry[0] == "pause" for entry in bench.log) == 1  # there was no pulse to wait for


@pytest.mark.parametrize("old_prescale", [3, 122, 255])
def test_chip_that_runs_at_another_frequency_is_stopped_for_a_whole_period_before_it_sleeps(bench, old_prescale):
    bench.another_board(old_prescale).initialise()
    bench.board.write({0: CENTER, 7: 4096})
    bench.log.clear()
    bench.board.initialise()  # Bench._note asserts it
    # the longest period that there is: 4096 counts of 256 cycles of 23 MHz
    assert [entry[1] for entry in bench.log if entry[0] == "pause"] == [pytest.approx(0.04559, abs=1e-5), 500e-6]
    assert bench.registers() == RUNNING
    assert bench.high_counts() == bench.board.held == [0] * 16


@pytest.mark.parametrize("mode1", [AUTO_INCREMENT, AUTO_INCREMENT | 0x01, 0],
                         ids=["alike", "answering_all_call", "without_auto_increment"])
def test_chip_that_already_runs_so_is_neither_put_to_sleep_nor_interrupted(running, mode1):
    running.board.write({0: CENTER, 1: 4096})
    running.chip.write(MODE1, [mode1])
    running.log.clear()
    board = running.another_board()
    board.initialise()
    assert running.writes() == [(MODE1, [AUTO_INCREMENT]), (MODE2, [0x04])]
    assert running.high_counts() == board.held == [CENTER, 4096] + [0] * 14


@pytest.mark.parametrize("changes, transfers", [
    ({0: CENTER}, [6]), ({15: 4096}, [6]), ({1: 10, 2: 4095, 9: 90}, [10, 6]),
    ({channel: 100 + channel for channel in range(16)}, [34, 34]), ({}, []),
], ids=["first", "last", "neighbours_and_a_distant_one", "all", "none"])
def test_changes_of_neighbours_are_one_transfer_and_the_others_are_left_alone(running, changes, transfers):
    running.board.write(changes)
    assert running.transfers == transfers
    assert running.high_counts() == running.board.held == [changes.get(channel, 0) for channel in range(16)]


def test_all_off_is_one_transfer_and_does_not_sleep(running):
    running.board.write({0: CENTER, 5: 4096})
    running.log.clear()
    running.board.all_off()
    assert running.writes() == [(ALL_LED_OFF_H, [0x10])]
    assert running.high_counts() == running.board.held == [0] * 16
    assert running.registers() == RUNNING


def test_check_of_a_chip_that_holds_what_was_written_reads_what_is_on_and_four_others_and_writes_nothing(running):
    """So few that a command waits for 3 ms at most."""
    running.board.write({0: CENTER, 7: 4096})
    running.log.clear()
    for _ in range(8):
        running.reads.clear()
        running.board.check()
        assert sum(length for _, length in running.reads) == 2 + 4 * (2 + 4)  # MODE1, PRE_SCALE, channels
    assert running.log == [] and running.board.held == [CENTER, *[0] * 6, 4096, *[0] * 8]


@pytest.mark.parametrize("channel, checks, on", [
    pytest.param(0, 1, (0, 1), id="a_channel_that_is_on_in_the_next_check"),
    pytest.param(2, 1, (0, 1), id="one_of_the_first_four_that_are_off_in_the_next_check"),
    pytest.param(15, 4, (0, 1), id="the_last_one_that_is_off_in_the_fourth_check"),
    pytest.param(15, 1, range(16), id="the_last_one_of_all_that_are_on_in_the_next_check"),
])
def test_foreign_write_is_found_and_known(running, channel, checks, on):
    running.board.write(dict.fromkeys(on, CENTER))
    written = CENTER if channel in on else 0
    running.chip.write(LED0_ON_L + 4 * channel, [0, 0, 0x10, 0x01])
    for _ in range(checks - 1):
        running.board.check()
    with pytest.raises(ForeignWrite, match=f"^channel {channel} holds 272 counts, not {written}$"):
        running.board.check()
    assert running.board.held[channel] == 272
    running.board.check()


@pytest.mark.parametrize("harm, text", [
    (lambda bench: bench.chip.power_up(), "MODE1 is 0x11 and PRE_SCALE 30, not 0x20 and 121"),
    (lambda bench: bench.another_board(30).initialise(), "MODE1 is 0x20 and PRE_SCALE 30, not 0x20 and 121"),
    (lambda bench: bench.chip.write(MODE1, [0x21]), "MODE1 is 0x21 and PRE_SCALE 121, not 0x20 and 121"),
], ids=["lost_its_power", "runs_at_another_frequency", "answers_at_the_address_of_all_boards"])
def test_chip_that_does_not_run_as_before_is_a_mismatch_and_no_foreign_write(running, harm, text):
    running.board.write({0: CENTER})
    harm(running)
    with pytest.raises(BoardMismatch, match=text) as caught:
        running.board.check()
    assert not isinstance(caught.value, ForeignWrite)


def test_external_clock_is_no_mismatch(running):
    """EXTCLK can be set asleep only, and stays until the power is off (data sheet 7.3.1)."""
    for mode1 in (SLEEP, SLEEP | 0x40, AUTO_INCREMENT):
        running.chip.write(MODE1, [mode1])
    assert running.registers() == [0x60, *RUNNING[1:]]
    running.board.check()


@pytest.mark.parametrize("act, works_for, held", [
    (lambda board: board.write({3: 100, 4: 100}), 0, [CENTER] * 3 + [None] * 2 + [CENTER] * 11),
    (lambda board: board.write(dict.fromkeys(range(16), 100)), 1, [100] * 8 + [None] * 8),
    (Board.all_off, 0, [None] * 16),
], ids=["a_write", "its_second_block", "all_off"])
def test_what_was_not_acknowledged_is_unknown_and_written_next_even_to_its_old_value(running, act, works_for, held):
    running.board.write(dict.fromkeys(range(16), CENTER))
    running.works_for = works_for
    with pytest.raises(OSError, match="Remote I/O error"):
        act(running.board)
    assert running.board.held == held
    running.works_for = None
    running.board.write(differences(running.board.held, [CENTER] * 16))
    assert running.high_counts() == running.board.held == [CENTER] * 16


@pytest.mark.parametrize("works_for", range(12))
def test_initialisation_that_fails_at_any_transfer_passes_the_error_on_and_can_be_repeated(bench, works_for):
    bench.another_board(122).initialise()
    bench.works_for = works_for
    with pytest.raises(OSError, match="Remote I/O error"):
        bench.board.initialise()
    bench.works_for = None
    bench.log.append(("write", "before the repetition"))
    bench.board.initialise()
    assert bench.registers() == RUNNING
