"""What a guard writes to the chip, on the register model: verified, and nothing to a chip that sleeps."""

import errno

import pytest

from car_interface.pca9685 import guard_board
from car_interface.sim.pca9685_chip import VirtualPca9685

AWAKE = 0x20  # MODE1 with auto-increment
LED0, ALL_LED_OFF_H = 0x06, 0xFD
COUNTS = (319, 307, 4096) + (0,) * 13


class Device:
    """A chip as the guard has it, whose transfers are counted and may fail."""

    def __init__(self):
        self.chip = VirtualPca9685()
        self.chip.write(0x00, [AWAKE])
        self.chip.write(LED0, [0, 0, 0xEE, 0, 0, 0, 0x77, 1])
        self.reads, self.writes = [], []
        self.works_for = None

    def read(self, register, length):
        self._count()
        assert length <= 32
        self.reads.append(length)
        return bytes(self.chip.read(register, length))

    def write(self, register, values):
        self._count()
        assert len(values) <= 32
        self.writes.append((register, len(values)))
        self.chip.write(register, list(values))

    def _count(self):
        if self.works_for is not None:
            if not self.works_for:
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            self.works_for -= 1

    def pulses(self):
        return tuple(self.chip.high_counts(channel) for channel in range(16))


@pytest.fixture
def device():
    return Device()


def test_timeout_values_go_to_every_channel_in_two_transfers_and_once_they_hold_are_only_read(device):
    assert guard_board.write_counts(device, COUNTS) == [COUNTS]
    assert device.pulses() == COUNTS
    assert guard_board.keep_counts(device, COUNTS) == [COUNTS]
    assert device.writes == [(LED0, 32), (LED0 + 32, 32)]
    assert device.reads == [1, 32, 32] * 2


@pytest.mark.parametrize("act", [
    lambda device: guard_board.write_counts(device, COUNTS), lambda device: guard_board.keep_counts(device, COUNTS),
    guard_board.switch_off], ids=["write", "keep", "switch_off"])
def test_what_the_chip_does_not_hold_afterwards_is_an_error(device, act):
    device.chip.write = lambda register, data: None
    with pytest.raises(OSError, match="the chip doesn't hold what was written") as caught:
        act(device)
    assert caught.value.errno == errno.EIO


def test_channel_that_was_changed_is_brought_back_and_what_it_held_is_told(device):
    guard_board.write_counts(device, COUNTS)
    device.chip.write(LED0 + 4 * 15, [0, 0, 1, 0])
    assert guard_board.keep_counts(device, COUNTS) == [(*COUNTS[:15], 1), COUNTS]
    assert device.pulses() == COUNTS


def test_full_off_is_one_bit_in_one_transfer_and_written_once_and_timeout_values_after_it_pulse_again(device):
    assert guard_board.switch_off(device) == guard_board.switch_off(device) == [(0,) * 16]
    assert device.pulses() == (0,) * 16
    assert device.writes == [(ALL_LED_OFF_H, 1)]
    assert device.chip.read(0x00, 1) == [AWAKE]  # not put to sleep
    assert guard_board.keep_counts(device, COUNTS) == [(0,) * 16, COUNTS]
    assert device.pulses() == COUNTS


@pytest.mark.parametrize("act, held", [
    (lambda device: guard_board.write_counts(device, COUNTS), [(0,) * 16]),
    (lambda device: guard_board.keep_counts(device, COUNTS), [(0,) * 16]),
    (guard_board.switch_off, [(0,) * 16]), (guard_board.probe, None),
], ids=["write", "keep", "switch_off", "probe"])
def test_chip_that_sleeps_as_after_a_loss_of_power_is_not_written_to(device, act, held):
    device.chip.power_up()
    assert act(device) == held
    assert device.writes == [] and device.reads == [1]
    assert device.pulses() == (0,) * 16


def test_chip_without_auto_increment_gets_it_first(device):
    device.chip.write(0x00, [0x01])
    guard_board.write_counts(device, COUNTS)
    assert device.pulses() == COUNTS
    assert device.writes[0] == (0x00, 1)
    assert device.chip.read(0x00, 1) == [0x21]


@pytest.mark.parametrize("act, transfers", [
    (guard_board.write_counts, 5), (guard_board.keep_counts, 3), (lambda device, _: guard_board.probe(device), 1),
], ids=["write", "keep", "probe"])
def test_error_of_any_transfer_is_passed_on(device, act, transfers):
    guard_board.write_counts(device, COUNTS)
    for works_for in range(transfers):
        device.works_for = works_for
        with pytest.raises(OSError, match="Remote I/O error"):
            act(device, COUNTS)
    device.works_for = transfers
    act(device, COUNTS)
