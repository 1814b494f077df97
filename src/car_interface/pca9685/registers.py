"""Duties, counts, registers and the prescale of a PCA9685. Pure arithmetic.

A duty is 0..65535 of the PWM period. The chip divides the period into 4096 counts; 0 counts stand for its full-off bit
and 4096 for its full-on bit (data sheet 7.3.3), so that neither limit has a glitch of one count.
"""
from __future__ import annotations

from car_interface.common.errors import ConfigError
from car_interface.common.units import MAX_DUTY

COUNTS = 4096
DUTY_PER_COUNT = 16  # 65536 / 4096
# Registers (data sheet 7.3, table 4).
MODE1, MODE2, LED0_ON_L, ALL_LED_OFF_H, PRE_SCALE = 0x00, 0x01, 0x06, 0xFD, 0xFE
RESTART, EXTCLK, AUTO_INCREMENT, SLEEP = 0x80, 0x40, 0x20, 0x10  # MODE1 bits (data sheet 7.3.1)
FULL_BIT = 0x10  # bit 4 of LEDn_ON_H: full on; of LEDn_OFF_H: full off
PRESCALE_MIN, PRESCALE_MAX = 3, 255  # 3 is forced by the hardware (data sheet 7.3.5)


def counts_of_duty(duty: int) -> int:
    """Return the counts, 0..4096, nearest to a duty of 0..65535, halves up."""
    return min(COUNTS, (duty + DUTY_PER_COUNT // 2) // DUTY_PER_COUNT)


def duty_of_counts(counts: int) -> int:
    """Return the duty of 0..4096 counts; 65535 for full on."""
    return min(MAX_DUTY, counts * DUTY_PER_COUNT)


def register_bytes(counts: int) -> bytes:
    """Return LEDn_ON_L, ON_H, OFF_L, OFF_H for a pulse of 0..4096 counts that begins with the period."""
    if counts <= 0:
        return bytes((0, 0, 0, FULL_BIT))
    if counts >= COUNTS:
        return bytes((0, FULL_BIT, 0, 0))
    return bytes((0, 0, counts & 0xFF, counts >> 8))


def counts_of_registers(registers) -> int:
    """Return for how many of 4096 counts a channel is high, by its ON_L, ON_H, OFF_L, OFF_H (data sheet 7.3.3)."""
    on_low, on_high, off_low, off_high = registers
    if off_high & FULL_BIT:  # full off wins over full on
        return 0
    if on_high & FULL_BIT:
        return COUNTS
    return ((off_high % 16 * 256 + off_low) - (on_high % 16 * 256 + on_low)) % COUNTS


def prescale_for(frequency_hz: float, oscillator_hz: float = 25e6) -> int:
    """Return the PRE_SCALE nearest to a PWM frequency: round(oscillator / (4096 · f)) − 1 (data sheet 7.3.5).

    121 for 50 Hz and the nominal 25 MHz; the frequency is then 50.03 Hz.

    Raises:
        ConfigError: naming the range, when the frequency is outside.
    """
    divider = min(oscillator_hz / (COUNTS * frequency_hz), 1e6)  # finite for any frequency above 0
    prescale = round(divider) - 1
    if not PRESCALE_MIN <= prescale <= PRESCALE_MAX:
        low, high = (frequency_for(p, oscillator_hz) for p in (PRESCALE_MAX, PRESCALE_MIN))
        raise ConfigError("frequency", frequency_hz, f"{low:.1f} to {high:.0f} Hz with this oscillator")
    return prescale


def frequency_for(prescale: int, oscillator_hz: float = 25e6) -> float:
    """Return the PWM frequency in Hz of a PRE_SCALE value."""
    return oscillator_hz / (COUNTS * (prescale + 1))
