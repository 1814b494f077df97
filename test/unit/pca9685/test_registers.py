"""Duties, counts, register bytes and the prescale, against the data sheet (NXP PCA9685, rev. 4) and exact numbers."""

from fractions import Fraction
from math import floor

import pytest

from car_interface.common.errors import ConfigError
from car_interface.pca9685.registers import (
    counts_of_duty,
    counts_of_registers,
    duty_of_counts,
    frequency_for,
    prescale_for,
    register_bytes,
)


def test_duty_each_of_65536_is_rounded_to_the_nearest_count_half_up():
    assert [counts_of_duty(duty) for duty in range(65536)] == [
        floor(Fraction(duty, 16) + Fraction(1, 2)) for duty in range(65536)]


def test_counts_as_a_duty_are_sixteen_each_and_65535_when_full_on_and_through_registers_stay_what_they_were():
    for counts in range(4097):
        assert duty_of_counts(counts) == min(16 * counts, 65535)
        assert counts_of_duty(duty_of_counts(counts)) == counts_of_registers(register_bytes(counts)) == counts


@pytest.mark.parametrize("counts, registers", [
    (-1, "00 00 00 10"), (0, "00 00 00 10"),  # off: bit 4 of OFF_H
    (1, "00 00 01 00"), (319, "00 00 3f 01"), (4095, "00 00 ff 0f"),
    (4096, "00 10 00 00"), (5000, "00 10 00 00"),  # on: bit 4 of ON_H and not that of OFF_H
])
def test_registers_of_counts_begin_the_pulse_with_the_period(counts, registers):
    assert register_bytes(counts) == bytes.fromhex(registers)


@pytest.mark.parametrize("frequency_hz, oscillator_hz, prescale", [
    (200, 25e6, 30), (1526, 25e6, 3), (24, 25e6, 253), (23.84, 25e6, 255),  # the data sheet's example and its ends
    (50, 25e6, 121), (50, 24.06e6, 116), (50, 27e6, 131),  # with the minus 1 that the original lacks
])
def test_prescale_for_frequency_follows_the_board_s_own_oscillator(frequency_hz, oscillator_hz, prescale):
    assert prescale_for(frequency_hz, oscillator_hz) == prescale


@pytest.mark.parametrize("prescale, frequency_hz", [(121, 50.03), (3, 1526), (255, 23.84)])
def test_frequency_of_prescale_at_25_mhz(prescale, frequency_hz):
    assert frequency_for(prescale) == pytest.approx(frequency_hz, abs=frequency_hz * 5e-4)


@pytest.mark.parametrize("frequency_hz", [1e-310, 23.7, 1800, 1e300])
def test_prescale_for_frequency_out_of_reach_is_refused(frequency_hz):
    with pytest.raises(ConfigError, match=r"frequency is .*; accepted: 23.8 to 1526 Hz with this oscillator"):
        prescale_for(frequency_hz)


@pytest.mark.parametrize("registers, counts", [
    ((0x99, 0x01, 0xCC, 0x04), 0x4CC - 0x199),  # data sheet 7.3.3, example 1
    ((0xFF, 0x0E, 0x32, 0x0B), 0xB32 - 0xEFF + 4096),  # across the end of the period
    ((0xFF, 0xEE, 0x32, 0xEB), 0xB32 - 0xEFF + 4096),  # with the reserved bits
    ((0, 0x10, 0, 0), 4096), ((0, 0, 0, 0x10), 0), ((0, 0x10, 0, 0x10), 0), ((0, 0, 0x3F, 0x11), 0),
])
def test_counts_of_registers(registers, counts):
    assert counts_of_registers(bytes(registers)) == counts_of_registers(list(registers)) == counts
