"""The register model of the PCA9685, against statements of the data sheet (NXP PCA9685, rev. 4, 16 April 2015).

The numbers of registers and bits are written out here, from the data sheet's tables; none is taken from the model.
"""
from __future__ import annotations

import pytest

from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685

ADDRESS = 0x40
AWAKE, ASLEEP = 0x20, 0x30  # MODE1 with auto-increment
RESTART = 0x80


@pytest.fixture
def chip():
    return VirtualPca9685()


@pytest.fixture
def awake(chip):
    chip.write(0x00, [AWAKE])
    return chip


def led(channel):
    return 0x06 + 4 * channel


@pytest.mark.parametrize("register, value", [
    pytest.param(0x00, 0x11, id="MODE1_is_asleep_and_answers_all_call"),
    pytest.param(0x01, 0x04, id="MODE2_is_totem_pole"),
    pytest.param(0x02, 0xE2, id="SUBADR1"),
    pytest.param(0x03, 0xE4, id="SUBADR2"),
    pytest.param(0x04, 0xE8, id="SUBADR3"),
    pytest.param(0x05, 0xE0, id="ALLCALLADR"),
    pytest.param(0xFE, 0x1E, id="PRE_SCALE_makes_200_Hz"),
])
def test_register_after_power_up_holds_its_reset_value(chip, register, value):
    assert chip.read(register, 1) == [value]


def test_power_up_after_use_resets_everything_and_switches_the_channels_off(chip):
    fresh = [chip.read(register, 1) for register in range(256)]
    assert fresh[led(0):led(16)] == [[0], [0], [0], [0x10]] * 16
    chip.write(0x00, [0x70])
    chip.write(0xFE, [121])
    chip.write(0xFA, [1, 2, 3, 4])
    chip.write(0x00, [0x20])
    chip.power_up()
    assert [chip.read(register, 1) for register in range(256)] == fresh
    assert [chip.high_counts(channel) for channel in range(16)] == [0] * 16


def test_write_goes_on_to_the_next_register_with_auto_increment_only(chip):
    chip.write(led(0), [1, 2, 3])
    assert [chip.read(led(0) + offset, 1)[0] for offset in range(4)] == [3, 0, 0, 0x10]
    chip.write(0x00, [AWAKE])
    chip.write(led(3), [0x99, 0x01, 0xCC, 0x04, 0x12])
    assert chip.read(led(3), 5) == [0x99, 0x01, 0xCC, 0x04, 0x12]
    assert (chip.read(69, 3), chip.read(254, 3)) == ([0x10, AWAKE, 0x04], [0x1E, AWAKE, 0x04])  # round to MODE1


def test_auto_increment_that_a_transfer_sets_works_within_it(chip):
    chip.write(0x00, [ASLEEP, 0x04, 0xE2])  # figure 21: all registers in one transfer, AI initially clear
    assert chip.read(0x00, 3) == [ASLEEP, 0x04, 0xE2]


def test_prescale_is_blocked_awake(awake):
    awake.write(0xFE, [121])
    assert awake.read(0xFE, 1) == [0x1E]


@pytest.mark.parametrize("written, held", [(0, 3), (2, 3), (3, 3), (4, 4), (255, 255)])
def test_prescale_is_at_least_3(chip, written, held):
    chip.write(0xFE, [written])
    assert chip.read(0xFE, 1) == [held]


@pytest.mark.parametrize("prescale, frequency_hz", [(3, 1526), (255, 23.84), (121, 50.03)])
def test_prescale_sets_the_period(chip, prescale, frequency_hz):
    chip.write(0xFE, [prescale])
    assert 1 / chip.period_s() == pytest.approx(frequency_hz, rel=5e-4)


@pytest.mark.parametrize("registers, high", [
    pytest.param("99 01 cc 04", 819, id="section_7_3_3_example_1_a_fifth_after_a_delay"),
    pytest.param("65 0e cb 0c", 3686, id="section_7_3_3_example_2_a_pulse_into_the_next_period"),
    pytest.param("ff 01 ff 0b", 2560, id="figure_9_example_1_on_511_off_3071"),
    pytest.param("ff 07 ff 02", 2816, id="figure_9_example_2_on_2047_off_767"),
    pytest.param("fe 13 00 00", 4096, id="figure_9_example_3_bit_4_of_ON_H_is_full_on"),
    pytest.param("ff 03 ff 03", 0, id="figure_9_example_4_on_and_off_at_once_is_off"),
    pytest.param("00 00 3f 11", 0, id="bit_4_of_OFF_H_is_full_off"),
    pytest.param("00 10 00 10", 0, id="full_off_takes_precedence_over_full_on"),
    pytest.param("00 00 01 00", 1, id="shortest_pulse"),
    pytest.param("00 00 ff 0f", 4095, id="longest_pulse"),
])
def test_pin_of_a_channel_is_high_for(awake, registers, high):
    awake.write(led(4), list(bytes.fromhex(registers)))
    assert awake.high_counts(4) == high
    assert [awake.high_counts(other) for other in (3, 5)] == [0, 0]


def test_reserved_bits_of_channel_registers_are_not_writable(awake):
    awake.write(led(0), [0xFF] * 4)
    assert awake.read(led(0), 4) == [0xFF, 0x1F, 0xFF, 0x1F]


def test_all_led_registers_load_every_channel_and_read_as_zero(awake):
    awake.write(0xFA, [0x11, 0x02, 0x33, 0x04])
    for channel in range(16):
        assert awake.read(led(channel), 4) == [0x11, 0x02, 0x33, 0x04]
    assert awake.read(0xFA, 4) == [0, 0, 0, 0]


def test_all_led_off_h_alone_turns_every_channel_off(awake):
    awake.write(led(0), [0, 0, 0x3F, 0x01])
    awake.write(led(9), [0, 0x10, 0, 0])
    awake.write(0xFD, [0x10])
    assert [awake.high_counts(channel) for channel in range(16)] == [0] * 16


@pytest.mark.parametrize("register, value", [(0x01, 0x10), (0x02, 0x12), (0x03, 0x34), (0x04, 0x56), (0x05, 0x78)],
                         ids=["MODE2", "SUBADR1", "SUBADR2", "SUBADR3", "ALLCALLADR"])
def test_register_written_holds_what_was_written(chip, register, value):
    chip.write(register, [value])
    assert chip.read(register, 1) == [value]


@pytest.mark.parametrize("register", [70, 249])
def test_reserved_registers_hold_nothing(awake, register):
    awake.write(register, [0x55])
    assert awake.read(register, 1) == [0]


@pytest.fixture
def asleep(awake):
    """A chip that was put to sleep in the middle of a pulse."""
    awake.write(led(0), [0, 0, 0x3F, 0x01])
    awake.write(0x00, [ASLEEP])
    return awake


@pytest.mark.parametrize("registers, mode1", [
    ([0, 0, 0x3F, 0x01], RESTART | ASLEEP), ([0, 0x10, 0, 0], RESTART | ASLEEP), ([0, 0, 0x3F, 0x11], ASLEEP)],
    ids=["a_pulse", "full_on", "off"])
def test_sleep_makes_the_pins_low_and_sets_restart_unless_they_are_off(awake, registers, mode1):
    awake.write(led(0), registers)
    awake.write(0x00, [ASLEEP])
    assert awake.read(0x00, 1) == [mode1] and awake.high_counts(0) == 0


def test_waking_with_restart_set_keeps_the_pins_low_until_a_1_is_written_to_it(asleep):
    asleep.write(0x00, [AWAKE])
    assert asleep.read(0x00, 1) == [RESTART | AWAKE]  # a write of 0 has no effect on RESTART
    assert asleep.high_counts(0) == 0
    asleep.write(0x00, [RESTART | AWAKE])
    assert asleep.read(0x00, 1) == [AWAKE]
    assert asleep.high_counts(0) == 0x13F


@pytest.mark.parametrize("register, data", [(led(7), [0, 0, 1, 0]), (0xFD, [0x00])],
                         ids=["of_a_channel", "of_all_channels"])
def test_write_to_any_pwm_register_clears_restart(asleep, register, data):
    asleep.write(register, data)
    assert asleep.read(0x00, 1) == [ASLEEP]


def test_extclk_once_set_is_cleared_by_nothing_but_power(chip):
    chip.write(0x00, [0x10])
    chip.write(0x00, [0x50])
    chip.write(0x00, [0x00])
    assert chip.read(0x00, 1) == [0x40]
    chip.power_up()
    assert chip.read(0x00, 1) == [0x11]


def test_bus_carries_address_register_and_data_of_each_write():
    writes = []
    bus = VirtualBus({ADDRESS: VirtualPca9685()}, on_write=lambda *write: writes.append(write))
    bus.write_byte_data(ADDRESS, 0x00, 0x20)
    bus.write_i2c_block_data(ADDRESS, 0x06, [0, 0, 0x3F, 0x01])
    assert writes == [(ADDRESS, 0x00, [0x20]), (ADDRESS, 0x06, [0, 0, 0x3F, 0x01])]
    assert bus.read_byte_data(ADDRESS, 0x00) == 0x20
    assert bus.read_i2c_block_data(ADDRESS, 0x06, 4) == [0, 0, 0x3F, 0x01]
    assert len(writes) == 2


@pytest.mark.parametrize("transfer", [
    lambda bus: bus.read_byte_data(0x41, 0), lambda bus: bus.read_i2c_block_data(0x41, 0, 4),
    lambda bus: bus.write_byte_data(0x41, 0, 0), lambda bus: bus.write_i2c_block_data(0x41, 6, [0] * 4),
], ids=["read_of_a_byte", "read_of_a_block", "write_of_a_byte", "write_of_a_block"])
def test_bus_at_an_empty_address_fails_as_linux_does(transfer):
    writes = []
    with pytest.raises(OSError, match="Remote I/O error") as caught:
        transfer(VirtualBus({0x40: VirtualPca9685()}, on_write=lambda *write: writes.append(write)))
    assert caught.value.errno == 121
    assert writes == []


@pytest.mark.parametrize("transfer", [
    lambda bus: bus.write_i2c_block_data(ADDRESS, 6, [0] * 33), lambda bus: bus.read_i2c_block_data(ADDRESS, 6, 33),
], ids=["write", "read"])
def test_bus_refuses_a_block_of_more_than_32_bytes_as_smbus_does(transfer):
    with pytest.raises(ValueError, match="Data length cannot exceed 32 bytes, got 33"):
        transfer(VirtualBus({ADDRESS: VirtualPca9685()}))
