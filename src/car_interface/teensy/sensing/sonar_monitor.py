"""Watches the six sonars: which of them report, which reports to trust, and when to start them again.

Consumes the sonars' reports and the host's commands; answers with faults by name and their remedies.
The firmware's behaviour (observed on the original one, see test/data/firmware):

- A sonar that isn't connected is skipped. The first of the sequence missing at power-up silences all of them, until
  SONAR_START steps to the next.
- One whose echo pin is stuck high holds the others up for about the Teensy's uptime and reports 0; after 179 s of
  uptime (89 s on a Teensy 3.1) it silences all of them, until SONAR_START, and then again at that sonar.
- A reboot, another sequence or SONAR_START mends none of them: a fault stays until its sonar reports.
- SONAR_START while they run fires two sonars at once, and the second one receives the first one's echo. So it is sent
  only when none reports, and reports right after it aren't trusted.
- A pin that is stuck high as SONAR_START steps on can end another sonar's echo when it is released. Until its own sonar
  has reported, an echo that is shorter than the one before by more than the car has driven waits for the next one.

Pure: ``now_ns`` in, and its memory doesn't grow.
"""
from __future__ import annotations

from typing import Iterable, Mapping, NamedTuple, Sequence

from car_interface.common.units import NS_PER_MS, NS_PER_S
from car_interface.common.vehicle_geometry import SONARS
from car_interface.teensy.sensing.ranging import FIRMWARE_WAIT_MS, is_near_micros_wrap

MISSING_ROUNDS = 2  # rounds of the others without a report
STUCK_ZEROS, DROPPED_ZEROS = 2, 3  # echoes of 0 in a row
MAX_STALLS = 2  # in a row: all sonars stopped at the same one
DISTRUSTED_REPORTS = 2  # SONAR_START fires two sonars at once
# A report from before SONAR_START may still be on its way; the last false one comes at the end of a pulse of 38 ms.
BEFORE_START_MS, AFTER_START_MS = 15, 70
CUT_US, US_PER_M = 100, 5830  # an echo is cut if it is shorter by more, 2 cm; of the way there and back at 343 m/s
MAX_RETRY_NS = 60 * NS_PER_S  # between SONAR_STARTs that don't help
SEND_START, SEND_SEQUENCE = "SONAR_START", "SET_SONAR_SEQ"
# The sonars fire mostly ahead while the car drives forward, and for a while after it stopped: a short stop changes
# nothing. With obstacle_stop the speed that is allowed grows with the number of echoes a second from ahead; echoes from
# behind are of use to a car that stands or reverses. The two speeds differ, so that a car which stands doesn't switch
# with the noise of its speed.
FORWARD_MPS, BACKWARD_MPS = 0.15, -0.1
STAYS_AHEAD_NS = NS_PER_S
BLINK_SHOWN_NS = 10 * NS_PER_S  # as long as a reboot is
ALIVE_NS = NS_PER_S  # a link without any frame for longer shows nothing about sonars


class SonarFault(NamedTuple):
    sensor: int | None  # index in ``SONARS``; ``None`` for all of them
    description: str  # what is wrong
    next_step: str  # what its owner can do


class SonarMonitor:
    """Follows the six sonars of one Teensy.

    Args:
        restart_s: SONAR_START is wanted after this long without a report, while there should be some; 0 = never.
        sequence: the sonars in use, to be sent to each Teensy that boots; empty = the firmware's own order.
        ahead: the sequence while the car drives forward; empty = the same one.
    """

    def __init__(self, restart_s: float = 3.0, sequence: Iterable[int] = (), ahead: Iterable[int] = ()):
        self._restart_ns = round(restart_s * NS_PER_S)
        self._configured, self._ahead = tuple(sequence), tuple(ahead)
        self.starts = 0  # how many SONAR_STARTs it asked for
        # By sensor the ms after which it ends its pulse without an echo, though nobody configured that; the owner sets
        # it to what ``Ranging`` finds.
        self.clones: Mapping[int, float] = {}
        # The same: when the pin of a sensor was last released that had been high for over a second.
        self.blinked: dict[int, int] = {}
        self._zeros = [0] * len(SONARS)  # in a row
        self._stalls = [0] * len(SONARS)  # in a row, at this sensor
        self._missing: set[int] = set()  # until they report
        self._silent_ns: int | None = None  # the first SONAR_START since the last report
        self._stopped = False
        self._echoes: dict[int, tuple[int, int]] = {}  # the newest: (µs, when it was received)
        self._speed_mps = 0.0
        self._wants_ahead, self._forward_ns = False, 0  # the latter: when it last drove forward
        self._frame_ns: int | None = None
        self._forget_commands()
        self._forget_reports(0)

    def _forget_commands(self):
        self._usual = self.sequence = self._configured or tuple(range(len(SONARS)))  # as the firmware fires them
        self._is_ahead = False  # whether the sequence is the one for driving forward
        self.dropped: tuple = ()  # stuck sensors that were taken out of the sequence
        self.wait_ms = FIRMWARE_WAIT_MS  # as last commanded
        self._must_send = bool(self._configured)

    def _forget_reports(self, now_ns):
        self._since_ns = now_ns  # since when reports are expected
        self._newest: tuple | None = None  # (tick, when it was received)
        self._weaken_suspicions()
        self._last: int | None = None  # the sensor that reported last, since SONAR_START
        self._held: int | None = None  # the sensor whose pin may be high while others listen, since SONAR_START
        self._retry_ns = self._restart_ns
        self._trusted_after = (0, 0)  # reports still to be distrusted, tick until which all are

    def _weaken_suspicions(self):
        """Begin to count over: what was suspected stays, but takes another report or stall to be acted on."""
        self._others = [0] * len(SONARS)  # reports of other sonars since its own last one
        self._zeros = [min(zeros, STUCK_ZEROS) for zeros in self._zeros]
        self._stalls = [min(stalls, 1) for stalls in self._stalls]

    def opened(self, now_ns: int) -> None:
        """Begin with a port that was opened: the sonars' state is unknown, their order stays as commanded."""
        self._forget_reports(now_ns)
        self._frame_ns = None
        self._must_send = bool(self._configured or self.dropped) or self._is_ahead

    def rebooted(self, now_ns: int) -> None:
        """Take note that the Teensy rebooted: its sonars run, in its own order."""
        self._forget_commands()
        self._forget_reports(now_ns)
        self._stopped = False

    def frame(self, now_ns: int) -> None:
        """Take note of any frame: the Teensy is alive."""
        if self._frame_ns is None or now_ns - self._frame_ns > ALIVE_NS:
            self._since_ns = max(self._since_ns, now_ns)
        self._frame_ns = now_ns

    def tick(self, tick: int, now_ns: int) -> None:
        """Take the Teensy's clock, ms, by a pong or a sonar."""
        self._newest = (tick, now_ns)

    def stopped(self) -> None:
        """Take note that SONAR_STOP was sent on request."""
        self._stopped = True
        self._silent_ns = None

    def started(self, now_ns: int) -> None:
        """Take note that SONAR_START was sent."""
        self._stopped = False
        self._since_ns = now_ns
        self._silent_ns = now_ns if self._silent_ns is None else self._silent_ns
        suspect = self._suspect()
        self._held, self._last = self._held if suspect is None else suspect, None
        until = 0
        if self._newest is not None:
            tick, at_ns = self._newest
            until = tick + (now_ns - at_ns) // NS_PER_MS + AFTER_START_MS
        self._trusted_after = (DISTRUSTED_REPORTS, until)

    def sequence_set(self, sequence: Sequence[int], now_ns: int) -> None:
        """Take note that SET_SONAR_SEQ was sent on request: its sonars are used again."""
        self._usual = tuple(sequence)
        self._use(sequence, now_ns)

    def update_speed(self, speed_mps: float, now_ns: int) -> None:
        """Take the measured speed, forward positive: while the car drives forward, the sonars fire mostly ahead."""
        self._speed_mps = abs(speed_mps)
        if speed_mps >= FORWARD_MPS:
            self._wants_ahead, self._forward_ns = True, now_ns
        elif speed_mps <= BACKWARD_MPS or now_ns - self._forward_ns > STAYS_AHEAD_NS:
            self._wants_ahead = False

    def _use(self, sequence, now_ns):
        self.sequence = tuple(sequence)
        self.dropped = tuple(sensor for sensor in self.dropped if sensor not in sequence)
        self._held = None
        self._since_ns = max(self._since_ns, now_ns)
        self._weaken_suspicions()

    def wait_set(self, wait_ms: int) -> None:
        """Take note that SONAR_WAIT was sent."""
        self.wait_ms = wait_ms

    def report(self, sensor: int, echo_us: int, tick: int, now_ns: int) -> bool:
        """Take a report; return whether it may be trusted."""
        is_cut = self._may_be_cut(sensor, echo_us, now_ns)
        is_trusted = self._is_trusted(tick) and not is_cut
        self.tick(tick, now_ns)
        self._since_ns = now_ns
        self._retry_ns = self._restart_ns
        self._last = sensor
        self._stalls[sensor] = 0
        self._silent_ns = None
        self._missing.discard(sensor)
        for other in set(self.sequence):
            self._others[other] = 0 if other == sensor else self._others[other] + 1
            if self._others[other] >= MISSING_ROUNDS * len(self.sequence):
                self._missing.add(other)
        if is_trusted and not is_near_micros_wrap(tick):
            self._zeros[sensor] = 0 if echo_us else self._zeros[sensor] + 1
        return is_trusted

    def _may_be_cut(self, sensor, echo_us, now_ns):
        before_us, before_ns = self._echoes.get(sensor, (0, now_ns))
        self._echoes[sensor] = echo_us, now_ns
        if sensor == self._held:
            self._held = None
        closer_m = self._speed_mps * (now_ns - before_ns) / NS_PER_S
        return self._held is not None and echo_us < before_us - CUT_US - US_PER_M * closer_m

    def _is_trusted(self, tick):
        left, until = self._trusted_after
        if until:
            if tick < until - AFTER_START_MS - BEFORE_START_MS:
                return True  # it was on its way as SONAR_START was sent
            if tick > until:
                until = 0
        self._trusted_after = (max(0, left - 1), until)
        return not left and not until

    def next_command(self, now_ns: int) -> str | None:
        """Return what to send now: ``SEND_START``, ``SEND_SEQUENCE`` (``sequence`` has it already), or ``None``."""
        if not self._is_alive(now_ns):
            return None
        if self._must_send:
            self._must_send = False
            return SEND_SEQUENCE
        if self._ahead and self._wants_ahead != self._is_ahead:
            self._is_ahead = self._wants_ahead
            wanted = self._ahead if self._is_ahead else self._usual
            in_use = [sensor for sensor in wanted if sensor not in self.dropped]
            if in_use:
                self._use(in_use, now_ns)
                return SEND_SEQUENCE
        if self._stopped:
            return None
        in_use = set(self.sequence)
        for sensor in in_use if len(in_use) > 1 else ():
            if self._zeros[sensor] >= DROPPED_ZEROS or self._stalls[sensor] >= MAX_STALLS:
                self.sequence = tuple(other for other in self.sequence if other != sensor)
                self.dropped += (sensor,)
                self._last = None
                return SEND_SEQUENCE
        patience_ns = max(self._retry_ns, 2 * self.wait_ms * NS_PER_MS)
        if not self._restart_ns or now_ns - self._since_ns < patience_ns:
            return None
        suspect = self._suspect()
        if suspect is not None:
            self._stalls[suspect] += 1
        elif self.starts:
            self._retry_ns = min(2 * self._retry_ns, MAX_RETRY_NS)
        self.starts += 1
        self.started(now_ns)
        return SEND_START

    def _is_alive(self, now_ns):
        return self._frame_ns is not None and now_ns - self._frame_ns <= ALIVE_NS

    def _suspect(self):
        """Return the sonar at which they stopped: the one after the last that reported."""
        if self.sequence.count(self._last) != 1:  # one that fires more often has more than one after it
            return None
        return self.sequence[(self.sequence.index(self._last) + 1) % len(self.sequence)]

    def faults(self, now_ns: int) -> list[SonarFault]:
        """Return the faults; empty when all sonars in use report, or were stopped."""
        found = [SonarFault(sensor, f"{SONARS[sensor]} is stuck high and was taken out of the sequence",
                            "Check its echo wire and supply; when it is mended: ~set_sonar_sequence, or power the "
                            "Teensy off and on") for sensor in self.dropped]
        found += [SonarFault(sensor, f"{SONARS[sensor]} is a clone that holds its pulse for {timeout_ms:.0f} ms "
                             "without an echo: its ranges are right", f"Set ~no_echo_timeouts/{SONARS[sensor]} to "
                             f"{timeout_ms:.0f}, by which it is known from the start")
                  for sensor, timeout_ms in sorted(self.clones.items())]
        found += [SonarFault(sensor, f"{SONARS[sensor]}'s echo pin was high for over a second, and no sonar fired",
                             "Check its echo wire and supply")
                  for sensor, at_ns in sorted(self.blinked.items()) if now_ns - at_ns < BLINK_SHOWN_NS]
        if self._stopped or not self._is_alive(now_ns):
            return found
        for sensor in sorted({*self._usual, *self._ahead}.difference(self.dropped)):
            if self._zeros[sensor] >= STUCK_ZEROS or self._stalls[sensor]:
                found.append(SonarFault(sensor, f"{SONARS[sensor]} seems stuck high: it holds the other sonars up",
                                        "Check its echo wire and supply"))
            elif sensor in self._missing:
                found.append(SonarFault(sensor, f"{SONARS[sensor]} does not report: it seems not to be connected",
                                        "Check its plug and wires; for a car without it leave it out of "
                                        "~sonar_sequence"))
        # One that was just left out still holds the others up until the next SONAR_START.
        patience_ns = 2 * self._restart_ns if self.dropped else NS_PER_S
        if self.starts and self._silent_ns is not None and now_ns - self._silent_ns > patience_ns:
            found.append(SonarFault(None, f"no sonar reports, in spite of {self.starts} SONAR_STARTs",
                                    "Check the sonars' supply and plugs; for a car without sonars set "
                                    "~sonar_restart to 0"))
        return found


def describe(faults: Sequence[SonarFault]) -> tuple[str, str]:
    """Return all faults in one text, and all next steps in another."""
    steps = dict.fromkeys(fault.next_step for fault in faults)
    return "; ".join(fault.description for fault in faults), ". ".join(steps)
