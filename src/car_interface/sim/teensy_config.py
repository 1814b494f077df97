"""The properties of one simulated Teensy."""
from __future__ import annotations

from dataclasses import dataclass

from car_interface.common.errors import require
from car_interface.sim.teensy_sonars import LISTEN_US, SEQUENCE_MAX, SONARS

BOOT_MS = 300  # millis() when a Teensy starts the firmware's own code


@dataclass(frozen=True)
class FirmwareConfig:
    """The properties of one simulated Teensy; the defaults are the one in the cars.

    Attributes:
        baud: bits a second on the line, both ways.
        clock_start_ms: ``millis()`` at power-up, when the boot has ended; near 2**32 it wraps soon.
            After ``reboot`` it is 300.
        clock_drift_ppm: how much the Teensy's crystal is too fast (positive) or too slow.
        clock_ramp_ppm_per_h: how much that changes in an hour (a car that warms up).
        loop_us: true time of one pass of the loop, µs. The original's is not known.
        sonar_wait_ms: from an echo to the next sonar's ping, until SONAR_WAIT changes it.
        sonar_sequence: the sonars' order, until SET_SONAR_SEQ changes it.
        sonar_pulse_end_us: how long a sensor holds its echo pin high without an echo: 38 ms with an HC-SR04,
            200 ms with some clones.
        sonars_missing: the sensors that are not connected at power-up; see ``set_sonar``.
        wheel_positions: where the wheels (left, right) stand at power-up, in pulses: sets the levels of the hall pins.
        odometer_start: dist and dist_abs of both wheels at power-up. Not 0: then they have turned
            forward. After ``reboot`` it is 0.
        corrected_checksum: True for a firmware whose receiver sums with carry over unescaped bytes. Its other
            faults stay.
        pool_size: packets that receiver, queues and transmitter share.
        uart_buffer: bytes that wait in front of the line: of its 64 the firmware leaves 2 free.
        boot_byte: the X of the boot frame.
        seed: of the garbage that the packets' memory holds at power-up; None for zeros.

    Raises:
        ConfigError: a value that no Teensy could have.
    """

    baud: int = 115200
    clock_start_ms: int = BOOT_MS
    clock_drift_ppm: float = 0.0
    clock_ramp_ppm_per_h: float = 0.0
    loop_us: int = 50
    sonar_wait_ms: int = 50
    sonar_sequence: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    sonar_pulse_end_us: int = 38_000
    sonars_missing: tuple[int, ...] = ()
    wheel_positions: tuple[int, int] = (0, 0)
    odometer_start: int = 0
    corrected_checksum: bool = False
    pool_size: int = 32
    uart_buffer: int = 62
    boot_byte: int = 0xC1
    seed: int | None = None

    def __post_init__(self):
        require(self.baud > 0, "baud", self.baud, "more than 0")
        require(0 <= self.clock_start_ms < 1 << 32, "clock_start_ms", self.clock_start_ms, "0 to 2**32 - 1")
        require(abs(self.clock_drift_ppm) <= 10_000, "clock_drift_ppm", self.clock_drift_ppm, "-10000 to 10000")
        require(0 < self.loop_us <= 1000, "loop_us", self.loop_us, "1 to 1000")
        require(0 <= self.sonar_wait_ms < 1 << 32, "sonar_wait_ms", self.sonar_wait_ms, "0 to 2**32 - 1")
        require(
            LISTEN_US < self.sonar_pulse_end_us <= 1_000_000,
            "sonar_pulse_end_us", self.sonar_pulse_end_us, "more than 11428, up to 1000000",
        )  # fmt: skip
        require(self.pool_size > 0, "pool_size", self.pool_size, "more than 0")
        require(self.uart_buffer > 0, "uart_buffer", self.uart_buffer, "more than 0")
        require(0 <= self.boot_byte <= 0xFF, "boot_byte", self.boot_byte, "0 to 255")
        require(0 <= self.odometer_start < 1 << 32, "odometer_start", self.odometer_start, "0 to 2**32 - 1")
        sequence = self.sonar_sequence
        fine = 0 < len(sequence) <= SEQUENCE_MAX and set(sequence) <= set(range(SONARS))
        require(fine, "sonar_sequence", sequence, "1 to 24 sensors from 0 to 5")
        missing = self.sonars_missing
        require(set(missing) <= set(range(SONARS)), "sonars_missing", missing, "sensors from 0 to 5")
