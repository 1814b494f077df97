"""The register model of the PCA9685, against statements of the data sheet (NXP PCA9685, rev. 4, 16 April 2015).

The numbers of registers and bits are written out here, from the data sheet's tables; none is taken from the model.
"""

import pytest
from virtual_bus import VirtualBus

from car_interface.sim.pca9685_chip import VirtualPca9685

ADDRESS = 0x40
AWAKE, ASLEEP, RESTART = 0x20, 0x30, 0x80  # MODE1 with auto-increment; its bit 7
LED0, LED3, LED15 = 0x06, 0x12, 0x42
WAKE, SLEEP = (0x00, [AWAKE]), (0x00, [ASLEEP])
PULSE, FULL_ON, FULL_OFF = (LED0, [0, 0, 0x3F, 0x01]), (LED0, [0, 0x10, 0, 0]), (LED0, [0, 0, 0x3F, 0x11])
ALL = [0x11, 0x02, 0x33, 0x04]


@pytest.fixture
def chip():
    return VirtualPca9685()


@pytest.mark.parametrize("writes, register, held", [
    *(pytest.param([], register, [value], id=f"{name}_at_power_up") for register, (name, value) in enumerate((
        ("MODE1", 0x11), ("MODE2", 0x04), ("SUBADR1", 0xE2), ("SUBADR2", 0xE4), ("SUBADR3", 0xE8),
        ("ALLCALLADR", 0xE0)))),
    pytest.param([], 0xFE, [0x1E], id="PRE_SCALE_at_power_up_makes_200_Hz"),
    pytest.param([WAKE], LED15, [0, 0, 0, 0x10], id="channel_at_power_up_is_full_off"),
    *(pytest.param([(register, [0x12])], register, [0x12], id=f"register_{register}_holds_what_was_written")
      for register in range(1, 6)),
    pytest.param([(LED0, [1, 2, 3])], LED0, [3], id="write_without_auto_increment_stays_at_its_register"),
    pytest.param([WAKE, (LED3, [*ALL, 0x12])], LED3, [*ALL, 0x12], id="with_auto_increment_it_goes_on_to_the_next"),
    # Figure 21: all registers in one transfer, AI initially clear.
    pytest.param([(0x00, [ASLEEP, 0x04, 0xE2])], 0x00, [ASLEEP, 0x04, 0xE2], id="also_where_the_transfer_sets_it"),
    pytest.param([WAKE], 69, [0x10, AWAKE, 0x04], id="past_register_69_comes_MODE1"),
    pytest.param([WAKE], 254, [0x1E, AWAKE, 0x04], id="past_register_254_comes_MODE1"),
    pytest.param([WAKE, (0xFE, [121])], 0xFE, [0x1E], id="PRE_SCALE_is_blocked_awake"),
    *(pytest.param([(0xFE, [written])], 0xFE, [held], id=f"PRE_SCALE_of_{written}_is_{held}")
      for written, held in ((0, 3), (2, 3), (3, 3), (4, 4), (255, 255))),
    pytest.param([WAKE, (LED0, [0xFF] * 4)], LED0, [0xFF, 0x1F, 0xFF, 0x1F], id="reserved_bits_are_not_writable"),
    pytest.param([WAKE, (70, [0x55])], 70, [0], id="reserved_register_70_holds_nothing"),
    pytest.param([WAKE, (249, [0x55])], 249, [0], id="reserved_register_249_holds_nothing"),
    pytest.param([WAKE, (0xFA, ALL)], LED0, ALL * 15, id="ALL_LED_loads_every_channel"),
    pytest.param([WAKE, (0xFA, ALL)], 0xFA, [0] * 4, id="ALL_LED_reads_as_zero"),
    pytest.param([WAKE, PULSE, SLEEP], 0x00, [RESTART | ASLEEP], id="sleep_with_a_pulse_sets_RESTART"),
    pytest.param([WAKE, FULL_ON, SLEEP], 0x00, [RESTART | ASLEEP], id="sleep_with_a_pin_full_on_sets_it"),
    pytest.param([WAKE, FULL_OFF, SLEEP], 0x00, [ASLEEP], id="sleep_with_all_pins_off_does_not"),
    pytest.param([WAKE, PULSE, SLEEP, WAKE], 0x00, [RESTART | AWAKE], id="a_0_written_to_it_has_no_effect"),
    pytest.param([WAKE, PULSE, SLEEP, WAKE, (0x00, [RESTART | AWAKE])], 0x00, [AWAKE], id="a_1_clears_it"),
    pytest.param([WAKE, PULSE, SLEEP, (LED3, [0, 0, 1, 0])], 0x00, [ASLEEP], id="so_does_a_write_to_a_channel"),
    pytest.param([WAKE, PULSE, SLEEP, (0xFD, [0x00])], 0x00, [ASLEEP], id="and_one_to_all_channels"),
    pytest.param([(0x00, [0x10]), (0x00, [0x50]), (0x00, [0x00])], 0x00, [0x40], id="EXTCLK_once_set_stays"),
])
def test_register_holds(chip, writes, register, held):
    for write in writes:
        chip.write(*write)
    assert chip.read(register, len(held)) == held


def test_power_up_after_use_resets_everything(chip):
    fresh = [chip.read(register, 1) for register in range(256)]
    for write in ((0x00, [0x70]), (0xFE, [121]), (0xFA, ALL), WAKE):
        chip.write(*write)
    chip.power_up()
    assert [chip.read(register, 1) for register in range(256)] == fresh
    assert [chip.high_counts(channel) for channel in range(16)] == [0] * 16


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
def test_pin_of_a_channel_is_high_for(chip, registers, high):
    chip.write(*WAKE)
    chip.write(LED3, list(bytes.fromhex(registers)))
    assert [chip.high_counts(channel) for channel in (2, 3, 4)] == [0, high, 0]


@pytest.mark.parametrize("writes, high", [
    ([], 0x13F), ([SLEEP], 0), ([SLEEP, WAKE], 0), ([SLEEP, WAKE, (0x00, [RESTART | AWAKE])], 0x13F),
    ([(0xFD, [0x10])], 0),
], ids=["awake", "asleep", "awake_with_RESTART_set", "after_a_1_was_written_to_RESTART", "all_full_off"])
def test_pulse_comes_while_awake_and_after_sleep_once_restart_is_cleared(chip, writes, high):
    for write in (WAKE, PULSE, *writes):
        chip.write(*write)
    assert [chip.high_counts(channel) for channel in range(16)] == [high] + [0] * 15


def test_bus_carries_address_register_and_data_of_each_write():
    writes = []
    bus = VirtualBus({ADDRESS: VirtualPca9685()}, on_write=lambda *write: writes.append(write))
    bus.write_i2c_block_data(ADDRESS, 0x00, [0x20])
    bus.write_i2c_block_data(ADDRESS, 0x06, [0, 0, 0x3F, 0x01])
    assert writes == [(ADDRESS, 0x00, [0x20]), (ADDRESS, 0x06, [0, 0, 0x3F, 0x01])]
    assert bus.read_byte_data(ADDRESS, 0x00) == 0x20
    assert bus.read_i2c_block_data(ADDRESS, 0x06, 4) == [0, 0, 0x3F, 0x01]
    assert len(writes) == 2
