"""Simulates the Teensy's deployed firmware as seen from its serial line: every byte, every fault, every millisecond.

Consumes the bytes that a host writes, the pulses of two wheels and the echoes of six sonars; produces the bytes that
leave the UART, each no earlier than the line carries it. It shares no code with the host's side of the protocol.

It has the faults of the original on purpose, so that a host that works with it also works with the Teensys in the
cars: the receiver's four, the boot frame, the filler that is never filled, the starving packet pool, the hall pins that
are never read, echoes without a limit, pings that hold the loop up, deadlines that fail at the clock's wrap. Frames,
times and fields are compared with captures of the original in test/unit/sim/test_captures.py.

The firmware is one loop. Here it is a generator that yields when it goes on: at the next pass with something to do, or,
while a ping holds it up, when that ends. Interrupts (pulses, the ends of echoes, the timer) happen in between.
Times are those of ``teensy_clock``.
"""
from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import partial
from random import Random
from typing import Callable, Generator

from car_interface.common import declared
from car_interface.common.errors import require
from car_interface.sim import teensy_uart as uart
from car_interface.sim.teensy_clock import NEVER_NS, NS_PER_US, UINT32, Clock
from car_interface.sim.teensy_sensors import FORWARD, HALL_PINS, SEQUENCE_MAX, Axle, Held, SonarArray, SonarSensor

U32 = struct.Struct("<I")
SONAR_ECHO = struct.Struct("<HI")  # echo µs, when: after the sensor and the filler byte
BOOT_MS = 300  # millis() when a Teensy starts the firmware's own code
SONAR_WAIT_MS = 50  # from an echo to the next sonar's ping, until SONAR_WAIT changes it


@dataclass(frozen=True)
class FirmwareConfig:
    """The properties of one simulated Teensy; the defaults are the one in the cars."""

    # ``millis()`` at power-up, as the boot has ended; near 2**32 it wraps soon; 300 after ``reboot``.
    clock_start_ms: float = declared.number(
        "clock_start_ms", BOOT_MS, "the Teensy's clock at its power-up", "ms", low=0, high=2 ** 32 - 1,
        default_text="random, up to an hour")
    clock_drift_ppm: float = declared.number(
        "clock_drift_ppm", 0.0, "how much it is too fast", "ppm", low=-10_000, high=10_000,
        default_text="random, up to ±50")
    corrected_checksum: bool = declared.flag(  # sums with carry over unescaped bytes; its other faults stay
        "corrected_checksum", False, "true = its receiver's checksum is repaired")
    sonar_pulse_end_us: int = declared.integer(  # 38 ms with an HC-SR04
        "sonar_pulse_end", 38_000, "how long a sonar without an echo holds its pin", "µs", low=12_000, high=1_000_000)
    # Also of the garbage that the packets' memory holds at power-up; None for zeros.
    seed: int | None = declared.integer(
        "seed", None, "of everything that is random, and of noise", low=0, default_text="random, logged")
    clock_ramp_ppm_per_h: float = 0.0  # how much the drift changes in an hour (a car that warms up)
    loop_us: int = 50  # true time of one pass of the loop, µs. The original's is not known.
    sonar_sequence: tuple[int, ...] = (0, 1, 2, 3, 4, 5)  # the sonars' order, until SET_SONAR_SEQ changes it
    # Where the wheels (left, right) stand at power-up, in pulses: sets the levels of the hall pins.
    wheel_positions: tuple[int, int] = (0, 0)


class TeensyFirmware:
    """A powered Teensy with two wheels and six sonars on it.

    Args:
        echo_us: ``(sensor, at_ns) -> µs`` from a ping to its echo; 0 when nothing is near enough: then the sensor ends
            its pulse by itself. Without it no sonar gets an echo.
        power_up_ns: the true time at which its boot ends and it begins to work.

    Attributes:
        clock: its own; another one after a reboot.
        counters: every counter that GET_COUNTERS can report, by name.
    """

    def __init__(self, config: FirmwareConfig, echo_us: Callable[[int, int], float] | None = None,
                 power_up_ns: int = 0):
        echo_us = echo_us or (lambda sensor, at_ns: 0)
        self._config = config
        self._period_ns = config.loop_us * NS_PER_US
        self._incoming = uart.Wire()
        self._outgoing = uart.Wire()
        self._sensors = [
            SonarSensor(config.sonar_pulse_end_us, partial(echo_us, number), Random(f"{config.seed} {number}"))
            for number in range(uart.SONARS)]
        self._positions = list(config.wheel_positions)
        self._now_ns = power_up_ns
        self._switch_on(int(config.clock_start_ms), power_up_ns)

    def _switch_on(self, clock_start_ms: int, clock_start_ns: int):
        config = self._config
        self.clock = Clock(clock_start_ms, config.clock_drift_ppm, config.clock_ramp_ppm_per_h, clock_start_ns)
        self.counters: dict[str, int] = dict.fromkeys(uart.COUNTER_NAMES, 0)
        self._pool = uart.PacketPool(config.seed)
        self._receiver = uart.Receiver(self._pool.acquire, self.counters, config.corrected_checksum)
        self._transmitter = uart.Transmitter(self._outgoing, self._pool, self.counters)
        self._axle = Axle(self.clock, self.counters)
        self._sonars = SonarArray(config.sonar_sequence, SONAR_WAIT_MS, self._sensors, self.clock, self._pool,
                                  self.counters)
        self._runs = False  # it boots; later, it hangs and only a reboot helps
        self._is_between_passes = False
        self._resume_ns = clock_start_ns
        self._loop = self._run()
        next(self._loop)

    def advance(self, now_ns: int):
        """Simulate until ``now_ns``. A time that has passed already changes nothing."""
        while True:
            interrupt_ns = self._sonars.interrupt_ns
            at_ns = min(interrupt_ns, self._resume_ns)
            if at_ns > now_ns:
                break
            self._now_ns = max(at_ns, self._now_ns)
            if at_ns == interrupt_ns:
                self._sonars.interrupt(self._now_ns)
                self._wake(self._now_ns)
            else:
                self._resume()
        self._now_ns = max(now_ns, self._now_ns)

    def receive(self, data: bytes, now_ns: int):
        """Take bytes that the host began to write at ``now_ns``; they arrive one after the other at the line's pace."""
        self.advance(now_ns)
        self._incoming.write(data, self._now_ns)
        self._wake(self._incoming.next_ns)

    def receive_backlog(self, now_ns: int) -> int:
        """Return how many of the host's bytes the line hasn't carried yet: a writer of a flood waits for them."""
        self.advance(now_ns)
        return self._incoming.backlog

    def transmit(self, now_ns: int) -> bytes:
        """Simulate until ``now_ns`` and return the bytes that have left the UART by then, each once."""
        self.advance(now_ns)
        return self._outgoing.collect(self._now_ns)

    def wheel_pulse(self, side: int, direction: int, at_ns: int):
        """Turn one rear wheel from one of its magnets' fields into the next: one of its two hall pins changes.

        Args:
            at_ns: its true time; pulses come in order, a late one happens now.
        """
        self.advance(at_ns)
        before = HALL_PINS[self._positions[side] % 4]
        self._positions[side] += 1 if direction == FORWARD else -1
        pins = HALL_PINS[self._positions[side] % 4]
        if not self._runs:
            return
        self._axle.interrupt(side, before ^ pins, pins, self.clock.tick(self._now_ns))
        self._wake(self._now_ns)

    def reboot(self, now_ns: int, off_ns: int = 0):
        """Cut its power for ``off_ns``, after which it boots for 300 ms.

        A frame on the line is cut. Until the boot has ended the wheels turn uncounted and bytes from the host are lost.
        Clock, odometers and counters restart, and so do the sonars with the first one of their sequence.
        """
        self.advance(now_ns)
        self._outgoing.cut(self._now_ns)
        clock_start_ns = self._now_ns + off_ns
        self._switch_on(0, clock_start_ns)
        self._resume_ns = self.clock.reaches_ns(BOOT_MS, clock_start_ns)

    def set_sonar(self, sensor: int, condition: str, now_ns: int):
        """Set a sensor to SONAR_FINE, SONAR_MISSING (not connected), SONAR_STUCK, SONAR_BLINK or SONAR_CLONE.

        A stuck sensor raises its echo pin at its next ping and holds it high until it is fine again. One that blinks
        holds it for 1.5 to 2 s from now on, and is fine then. A clone ends its pulse after 200 ms without an echo.

        Raises:
            ConfigError: no such sensor.
        """
        require(sensor in range(uart.SONARS), "sonar", sensor, "a sensor from 0 to 5")
        self.advance(now_ns)
        self._sensors[int(sensor)].set_condition(condition, self._now_ns)
        self._sonars.schedule()

    # The loop

    def _run(self) -> Generator[int, int, None]:
        now_ns = yield self._resume_ns
        self._runs = True
        self._incoming.collect(now_ns)  # lost
        now_ns = yield from self._sonars.begin(now_ns)
        self._axle.begin(now_ns)
        while True:
            now_ns = yield from self._read_line(now_ns)
            now_ns = yield from self._sonars.ping_when_due(now_ns)
            report = self._axle.report_when_due(now_ns)
            if report is not None:
                self._transmitter.queue_wheels(report)
            self._transmitter.poll(now_ns)
            self._report_echo(now_ns)
            now_ns = yield self._next_pass_ns(now_ns)

    def _resume(self):
        self._is_between_passes = False
        try:
            self._resume_ns = self._loop.send(self._now_ns)
        except uart.PoolEmpty:
            self._runs = False
            self._resume_ns = NEVER_NS

    def _next_pass_ns(self, now_ns: int) -> int:
        """Return the next pass that finds something to do."""
        self._is_between_passes = True
        wanted_ns = min(self._incoming.next_ns, self._sonars.due_ns, self._axle.due_ns, self._transmitter.due_ns)
        return max(self._pass_ns(wanted_ns), self._pass_ns(now_ns + 1))

    def _pass_ns(self, at_ns: int) -> int:
        return -(-at_ns // self._period_ns) * self._period_ns

    def _wake(self, at_ns: int):
        """Wake the loop for something to do. While it is held up, it finds that by itself."""
        if self._is_between_passes:
            self._resume_ns = min(self._resume_ns, self._pass_ns(at_ns))

    def _read_line(self, now_ns: int) -> Held:
        now_ns = yield from self._sonars.retry(now_ns)
        while self._incoming.next_ns <= now_ns:
            packet = self._receiver.byte(self._incoming.pop())
            if packet is None:
                continue
            if packet[0] == uart.TEENSY and packet[2] == uart.PING_QUERY:
                self._pong(packet, now_ns)
                continue
            if packet[0] == uart.TEENSY and packet[2] == uart.SONAR_START:
                now_ns = yield from self._sonars.start(now_ns)
            elif packet[0] == uart.TEENSY:
                self._obey(packet)
            self._pool.release(packet)
        return now_ns

    def _report_echo(self, now_ns: int):
        echo, self._sonars.echo = self._sonars.echo, None
        if echo is None:
            return
        packet = self._transmitter.new_packet(uart.SONAR_STATUS)
        if packet is None:
            # The firmware schedules the next ping when it handles the report. No packet, no report, no next ping:
            # the sonars report nothing until SONAR_START.
            return
        sensor, echo_us, when = echo
        packet[4] = sensor
        SONAR_ECHO.pack_into(packet, 6, echo_us, when)
        self._transmitter.queue_sonar(sensor, packet)
        self._sonars.wait(now_ns)

    # Requests of the host

    def _pong(self, packet: bytearray, now_ns: int):
        """Turn the ping itself into its answer, as the firmware does: the rest of it stays as it was."""
        packet[:3] = bytes((packet[1], uart.TEENSY, uart.PONG_RESP))
        U32.pack_into(packet, 8, self.clock.millis(now_ns))
        self._transmitter.queue_first(packet)

    def _obey(self, packet: bytearray):
        command = packet[2]
        if command == uart.SET_SONAR_SEQ:
            self._sonars.set_sequence(packet[4], packet[5 : 5 + SEQUENCE_MAX])
        elif command == uart.SONAR_STOP:
            self._sonars.running = False
        elif command == uart.SONAR_WAIT:
            (self._sonars.wait_ms,) = U32.unpack_from(packet, 4)
        elif command == uart.WHEEL_RESET:
            self._axle.reset()
        elif command == uart.GET_COUNTERS:
            self._send_counters()
        elif command != uart.PONG_RESP:  # which the firmware knows, and never asks for
            self.counters["rxErrorUnknown"] += 1

    def _send_counters(self):
        for name, count in [item for item in self.counters.items() if item[1]]:
            answer = self._transmitter.new_packet(uart.ERROR_COUNT)
            if answer is not None:
                U32.pack_into(answer, 4, count & UINT32)
                answer[8:32] = name.encode("ascii").ljust(24, b"\0")
                self._transmitter.queue_first(answer)
