"""Runs a case: people, messages that are late, the arbiter under test, the servo board, ESC, car; and the judge.

The judge knows the script and the models alone. A reversal: the ESC drives the motor backward for longer than 20 ms,
and it began to while neither a person nor a planner wanted reverse; or it goes on for long after they ceased to.
"""
from __future__ import annotations

import heapq
import math
import random
from dataclasses import replace
from typing import NamedTuple

from adversary.car_model import CarModel
from adversary.cases import (
    ANY,
    AUTONOMOUS,
    COAST,
    CUT_FAULT,
    DEATH,
    DRIVE,
    HOLD,
    ODOMETRY_LATE,
    ODOMETRY_LOST,
    OFF,
    OFF_HELD,
    OUTPUT_LATE,
    OUTPUT_LOST,
    SECOND,
    STALL,
    STOP,
    WALL,
    Case,
)
from adversary.esc_model import BACKWARD, BTR, FORWARD_ONLY, EscModel
from car_interface.pca9685.channels import ChannelConfig, Channels
from car_interface.throttle.arbiter import TELEOP, ThrottleArbiterConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.stick import StickConfig, shaped

MS, S = 1_000_000, 1_000_000_000
STEP_NS, TICK_NS, PERIOD_NS = 5 * MS, 20 * MS, 20 * MS  # the car's step, the nodes' timers, the pulses
KEEP_ALIVE_NS, OUTPUT_NS = 40 * MS, 100 * MS  # commands to the board, and its reports, without a change
STOOD_STILL_NS = 500 * MS  # a node that stood still for so long obeys nothing that came meanwhile: docs/safety.md
START_NS = 1000 * S
CHANNEL, NEUTRAL, SPAN, COUNT = 1, 4915, 1639, 16
SHIPPED = ThrottleCalibration(channel=CHANNEL, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, NEUTRAL, 6554],
                              neutral=NEUTRAL)

LONGEST_NS = 20 * MS  # a shorter push backward moves nothing
ROLLS_MPS = 0.05  # a push backward against wheels that roll forward faster slows them, as each kind's pull does there
WAY_NS = 80 * MS  # from a wish to the ESC: message, timer, board, pulse
LINGERS_NS = 350 * MS  # a wanted reverse has ended so long after it was wanted
STANDS_MPS = 0.35  # a second pull of a stick above it is a brake
SHOWN_MPS, SLIGHTLY_MPS = -0.2, -0.05  # odometry that shows backward motion: as esc/motion_speed, and at all
STANDSTILL_MPS, HIT_MPS = 0.1, 0.05  # odometry that shows standstill; a wall that stops the car all at once
RECENT_NS = 1000 * MS  # a fault that ended so recently is named
SUDDEN_NS = 300 * MS  # a brake that becomes reverse so soon after the wheels stopped all at once comes of that
LOCKED, HIT, SLOWED = "locked", "hit a wall", "rolled forward to its end"
POWERED, RELEARNED, NO_STAMP = "powered anew", "learned another neutral", "no stamp"
PULL_MIN = 0.08  # esc/dead_band_reverse: a weaker pull moves nothing

_INPUT, _ODOMETRY, _OUTPUT = range(3)


class Reversal(NamedTuple):
    """What the judge found.

    Attributes:
        want: stop, hold, or what else it was that isn't reverse.
        faults: what was wrong then.
        lowest_mps, lasts_s: the speed, and how long the ESC drove the motor backward.
        shown_s: how long it went on after odometry that shows it; NaN: none did.
        slightly_s: the same, of the first odometry below −0.05 m/s.
        stood_s: when it ended, after odometry that shows wheels which a wall or the brake stopped all at once.
        stopped_s: the same, after they stopped.
    """

    at_s: float
    want: str
    faults: tuple
    lowest_mps: float
    lasts_s: float
    shown_s: float
    slightly_s: float
    stood_s: float
    stopped_s: float


class Result(NamedTuple):
    """A sequence: reversals, and how many wanted ones were due and came about; where the last stop began and ended."""

    reversals: list
    wanted: int
    got: int
    stop_m: float
    story: list


class World:
    """One case, step by step; ``run`` has the result.

    Args:
        tells: whether to keep a story.
    """

    def __init__(self, case: Case, tells: bool = False):
        self.case = case
        self.rng = _Even() if case.is_even else random.Random(f"world {case.name}")
        self.esc, self.car = EscModel(case.esc), CarModel(case.car)
        self.story = [] if tells else None
        self.now_ns = START_NS
        rng = self.rng
        self.tick_ns = START_NS + rng.randrange(20) * MS
        self.input_ns = START_NS + rng.randrange(20) * MS
        self.pulse_ns = START_NS + rng.randrange(20) * MS
        self.odometry_ns = START_NS + rng.randrange(20) * MS
        self.control = self._start()
        self.board = Channels(_channels(case.config))
        self.held = None  # counts on the ESC's channel, as reported
        self.output_ns = START_NS
        self.pulse = 0.0
        self.inbox, self.commands, self.number = [], [], 0
        self.duty, self.sent_ns, self.decision = None, 0, None
        self.was_blocked = False
        self.away_ns = None  # since when the arbiter is away
        self.wheels_stand_ns = self.seen_ns = None  # since when, all at once, and when odometry showed it
        self.skip_s, self.index, self.stop_m = 0.0, 0, math.nan
        self.released_ns = START_NS  # when the deadman was released last
        self.segment_ns = START_NS  # when the script's present one began
        self.sent_segment = None
        self.ticks = 0
        self.last_odometry = (math.nan, START_NS - S)  # what arrived, when
        self.known_ns = START_NS - S  # the newest speed's stamp
        self.last_arrival_ns = 0
        self.latest_ns = {}  # by fault
        self.reverse_wanted_ns = -S  # when reverse was wanted last
        self.power = None  # how the ESC was powered anew, if it has not driven forward since
        # The push backward that lasts.
        self.back_ns = None
        self.back = None
        self.reversals = []
        self.lowest_mps = 0.0
        self.second = None  # a wanted reverse that is due: [since, its segment's index, whether it came]
        self.wanted = self.got = 0

    def _start(self):
        arbiter = ThrottleArbiterConfig()
        arbiter = replace(arbiter, interlock=replace(arbiter.interlock, grant_at_start=False),
                          stick=replace(arbiter.stick, human_scale=self.case.human_scale))
        return ThrottleControl(SHIPPED, arbiter, EscConfig(**self.case.config))

    def run(self) -> Result:
        ends_ns = START_NS + round((self.case.script[-1].end_s + 0.5) * S)
        while self.now_ns < ends_ns - round(self.skip_s * S):
            self._step()
            if self.case.speed_mps and self.car.speed_mps == 0 and self.case.script[self.index].want == STOP:
                break
        self._end_of_push_back(is_over=True)
        self._end_of_second()
        return Result(self.reversals, self.wanted, self.got, self.stop_m, self.story)

    def _step(self):
        now_ns = self.now_ns = self.now_ns + STEP_NS
        now_s = (now_ns - START_NS) / S
        segment = self._segment(now_s + self.skip_s)
        active = self._faults(now_s) if self.case.faults else {}
        if now_ns >= self.input_ns:
            self.input_ns += TICK_NS
            self._publish_inputs(segment)
        if now_ns >= self.odometry_ns:
            self.odometry_ns += round(self.case.odometry.period_s * S)
            self._publish_odometry(active)
        self._arbiter(STALL in active or DEATH in active, DEATH in active)
        self._board(active)
        if now_ns >= self.pulse_ns:
            self.pulse_ns += PERIOD_NS
            self.pulse = (self.board.targets[CHANNEL] * COUNT - NEUTRAL) / SPAN
        esc, car = self.esc, self.car
        esc.step(self.pulse, car.wheel_mps, STEP_NS / S)
        if self.power == POWERED and esc.has_wrong_neutral:
            self.power = RELEARNED
        car.step(esc.motor, esc.level, self.case.esc.drag_brake if esc.is_on else 0.0, STEP_NS / S)
        if car.is_locked or car.hit_mps > HIT_MPS:
            name = LOCKED if car.is_locked else HIT
            if now_ns - self.latest_ns.get(name, 0) > STEP_NS:
                self.wheels_stand_ns, self.seen_ns = now_ns, None
            self.latest_ns[name] = now_ns
        if self.power and esc.brakes_next and not esc.has_wrong_neutral:
            self.power = None
        self._judge(segment)
        if self.story is not None and now_ns // STEP_NS % 4 == 0:
            self._tell(now_s, segment, active)

    def _segment(self, now_s):
        script = self.case.script
        while self.index < len(script) - 1 and now_s >= script[self.index].end_s:
            self._end_of_second()
            self.index += 1
            self.segment_ns = self.now_ns
            if not script[self.index].deadman:
                self.released_ns = self.now_ns
            if script[self.index].want in (SECOND, ANY):
                self._begin_second(script[self.index], now_s)
            if script[self.index].want in (STOP, HOLD):
                self.stop_m = self.car.x_m
        segment = script[self.index]
        if self.case.speed_mps and segment.want == DRIVE and self.car.speed_mps >= self.case.speed_mps:
            self.skip_s += segment.end_s - now_s
        return segment

    def _faults(self, now_s):
        active = {}
        for fault in self.case.faults:
            if fault.start_s <= now_s < fault.end_s:
                active[fault.name] = fault
                self.latest_ns[fault.name] = self.now_ns
        esc, car = self.esc, self.car
        esc.cut = int(active[CUT_FAULT].value) if CUT_FAULT in active else 0
        if OFF in active or OFF_HELD in active:
            esc.switch(False)
        elif not esc.is_on:
            is_held = self.pulse < -0.1
            if is_held or OFF_HELD not in self.latest_ns or self.now_ns - self.latest_ns[OFF_HELD] > 2 * S:
                esc.switch(True)
                self.power = POWERED
        if (WALL in active) != self.was_blocked:
            self.was_blocked = WALL in active
            ahead = self.was_blocked and active[WALL].value > 0
            behind = self.was_blocked and active[WALL].value < 0
            car.ahead_m = car.x_m if ahead else car.x_m + self.case.car.wall_m
            car.behind_m = car.x_m if behind else car.x_m - self.case.car.wall_behind_m
        return active

    def _post(self, delay_ns, kind, content):
        self.number += 1
        heapq.heappush(self.inbox, (self.now_ns + delay_ns, self.number, kind, content))

    def _publish_inputs(self, segment):
        """What teleop_logi, turn_arb and the planner send; mode, e-stop and gear less often, and when they change."""
        self.ticks += 1
        last, self.sent_segment = self.sent_segment, segment
        is_new = last is None or (last.mode, last.e_stop, last.gear) != (segment.mode, segment.e_stop, segment.gear)
        self._post(self.rng.randrange(1, 6) * MS, _INPUT, (segment, is_new or self.ticks % 5 == 0))

    def _publish_odometry(self, active):
        if ODOMETRY_LOST in active:
            return
        odometry = self.case.odometry
        delay_s = odometry.delay_s + (active[ODOMETRY_LATE].value if ODOMETRY_LATE in active else 0.0)
        speed = self.car.wheel_mps
        if speed:
            speed += self.rng.gauss(0.0, odometry.noise_mps)
        arrives_ns = self.now_ns + round(min(0.4, delay_s) * S * self.rng.uniform(0.9, 1.0))
        arrives_ns = self.last_arrival_ns = max(arrives_ns, self.last_arrival_ns)  # in order
        self._post(arrives_ns - self.now_ns, _ODOMETRY, (speed, self.now_ns))

    def _arbiter(self, is_away, is_dead):
        now_ns, inbox = self.now_ns, self.inbox
        if is_away:
            if self.away_ns is None:
                self.away_ns = now_ns
            if is_dead:
                self.control = None
            return
        decides = False
        if self.away_ns is not None:
            decides, away_ns, self.away_ns = True, now_ns - self.away_ns, None
            if self.control is None:
                self.control, self.duty = self._start(), None
                self._drop()
            elif away_ns >= STOOD_STILL_NS:
                self._drop()
                self.control.mark_stale(now_ns)
        while inbox and inbox[0][0] <= now_ns:
            at_ns, _, kind, content = heapq.heappop(inbox)
            decides |= self._deliver(kind, content, now_ns if decides else at_ns)
        while self.tick_ns <= now_ns:
            self.tick_ns += TICK_NS
            decides = True
        if not decides:
            return
        self.decision = self.control.decide(now_ns)
        duty = self.decision.duty
        if duty != self.duty or now_ns - self.sent_ns >= KEEP_ALIVE_NS:
            self.duty, self.sent_ns = duty, now_ns
            self.number += 1
            heapq.heappush(self.commands, (now_ns + self.rng.randrange(1, 11) * MS, self.number, duty))

    def _drop(self):
        while self.inbox and self.inbox[0][0] <= self.now_ns:
            heapq.heappop(self.inbox)

    def _deliver(self, kind, content, now_ns):
        """Hand a message over; whether the node decides at once."""
        control = self.control
        if kind == _OUTPUT:
            control.update_output(content, now_ns)
            return False
        if kind == _ODOMETRY:
            speed, stamp_ns = content
            self.last_odometry = speed, self.now_ns
            self.known_ns = stamp_ns if self.case.odometry.is_stamped else now_ns
            if self.wheels_stand_ns and not self.seen_ns and stamp_ns > self.wheels_stand_ns and speed < STANDSTILL_MPS:
                self.seen_ns = self.now_ns
            control.update_odometry(speed, now_ns, now_ns - stamp_ns if self.case.odometry.is_stamped else 0)
            return False
        segment, has_all = content
        arbiter = control.arbiter
        arbiter.update_steering(TELEOP, "", now_ns)
        if has_all:
            arbiter.update_mode(segment.mode, now_ns)
            arbiter.update_e_stop(segment.e_stop, now_ns)
        if segment.mode == AUTONOMOUS and segment.value is not None:
            if has_all and segment.gear:
                keeps_mps = -self.case.cruise_mps if segment.gear == "reverse" else self.case.cruise_mps
                cruise_mps = 0.0 if segment.want == STOP else keeps_mps
                arbiter.update_planner_state(segment.gear, None, now_ns, cruise_mps)
            control.update_planner(segment.value, now_ns)
        arbiter.update_teleop(segment.stick, now_ns)
        arbiter.update_human(segment.deadman, now_ns)
        return has_all

    def _board(self, active):
        now_ns, commands = self.now_ns, self.commands
        while commands and commands[0][0] <= now_ns:
            at_ns, _, duty = heapq.heappop(commands)
            vector = [-1] * 16
            vector[CHANNEL] = duty
            self.board.command(vector, at_ns)
        self.board.expire(now_ns)
        held = self.board.targets[CHANNEL]
        if held == self.held and now_ns < self.output_ns:
            return
        self.held, self.output_ns = held, now_ns + OUTPUT_NS
        if OUTPUT_LOST in active:
            return
        delay_ms = self.rng.randrange(1, 61) if self.rng.random() < 0.3 else self.rng.randrange(1, 6)
        if OUTPUT_LATE in active:
            delay_ms = max(60, active[OUTPUT_LATE].value * 1000 * self.rng.uniform(0.8, 1.0))
        vector = [-1] * 16
        vector[CHANNEL] = held * COUNT
        self._post(round(delay_ms) * MS, _OUTPUT, vector)

    def _is_reverse_wanted(self, segment):
        """A second pull of a stick wants reverse where the car stands, or nobody knows that it doesn't."""
        if segment.want == ANY:
            return True
        return segment.want == SECOND and (self.car.wheel_mps <= STANDS_MPS
                                           or self.now_ns - self.known_ns > S // 2)

    def _judge(self, segment):
        now_ns = self.now_ns
        if self._is_reverse_wanted(segment):
            self.reverse_wanted_ns = now_ns
        if self.esc.motor == BACKWARD:
            if self.second and self.second[1] == self.index:
                self.second[2] = True
            if self.back and self._is_reverse_wanted(segment):
                self._end_of_push_back()  # from now on it's wanted
            if self.back_ns is None:
                self._begin_push_back(segment)
            self._follow_push_back(segment)
        elif self.back_ns is not None:
            self._end_of_push_back()
        if self.second and self.latest_ns and any(now_ns - at_ns <= RECENT_NS for name, at_ns in self.latest_ns.items()
                                                  if name != ODOMETRY_LATE):
            self.second = None

    def _begin_push_back(self, segment):
        now_ns, since_ns = self.now_ns, self.away_ns
        away = since_ns is not None and since_ns - self.reverse_wanted_ns <= WAY_NS and now_ns - since_ns <= LINGERS_NS
        self.back_ns, self.shown_ns, self.slightly_ns, self.lowest_mps = now_ns, None, None, self.car.speed_mps
        self.back, self.driven_ns, self.stop_ns = None, 0, None
        if not away and now_ns - self.reverse_wanted_ns > WAY_NS:
            is_new = segment.want in (DRIVE, COAST, STOP) and now_ns - self.segment_ns <= WAY_NS
            self.back = self.case.script[self.index - bool(is_new)].want, self._named(now_ns)
            self.stop_ns = self.segment_ns if segment.want == STOP else None

    def _named(self, now_ns):
        is_seen = not self.wheels_stand_ns or self.seen_ns
        named = {name for name, at_ns in self.latest_ns.items()
                 if now_ns - at_ns <= (SUDDEN_NS if name in (LOCKED, HIT) and is_seen else RECENT_NS)}
        odometry = self.case.odometry
        if self.power:
            named.add(self.power)
        if odometry.delay_s > 0.05:
            named.add(f"odometry {math.ceil(odometry.delay_s * 10) / 10:.1f} s late")
        if not odometry.is_stamped and (odometry.delay_s > 0.05 or ODOMETRY_LATE in named):
            named.add(NO_STAMP)
        if min(self.car.ahead_m - self.car.x_m, self.car.x_m - self.car.behind_m) < 0.01:
            named.add(WALL)
        return tuple(sorted(named))

    def _follow_push_back(self, segment):
        now_ns = self.now_ns
        self.lowest_mps = min(self.lowest_mps, self.car.speed_mps)
        if self.car.wheel_mps <= ROLLS_MPS:
            if self.back and not self.driven_ns:
                want, faults = self.back
                self.back = want, tuple(sorted({*faults, *({LOCKED, HIT, NO_STAMP} & set(self._named(now_ns)))}))
            self.driven_ns += STEP_NS
        speed, arrived_ns = self.last_odometry
        if arrived_ns > self.back_ns and self.slightly_ns is None and speed < SLIGHTLY_MPS:
            self.slightly_ns = now_ns
        if arrived_ns > self.back_ns and self.shown_ns is None and speed < SHOWN_MPS:
            self.shown_ns = now_ns
        if self.back is None and self.away_ns is None and now_ns - self.reverse_wanted_ns > LINGERS_NS \
                and not any(now_ns - self.latest_ns.get(name, 0) <= LINGERS_NS for name in (STALL, DEATH)):
            self.back = f"{segment.want}, lingers", self._named(now_ns)

    def _end_of_push_back(self, is_over=False):
        if self.back_ns is None or is_over and self.esc.motor != BACKWARD:
            return
        if self.back and max(self.driven_ns, self.now_ns - self.back_ns if self.driven_ns == 0 else 0) > LONGEST_NS:
            want, faults = self.back
            if self.stop_ns and self.now_ns - self.stop_ns > 2 * WAY_NS:
                want = STOP  # it outlasts the brake before the stop by more than a message's way
            if not self.driven_ns:
                faults = (*faults, SLOWED)
            def since(at_ns):
                return math.nan if at_ns is None else (self.now_ns - at_ns) / S
            self.reversals.append(Reversal(
                (self.back_ns - START_NS) / S, want, faults, self.lowest_mps, since(self.back_ns), since(self.shown_ns),
                since(self.slightly_ns), since(self.seen_ns),
                since(self.wheels_stand_ns)))
        self.back_ns = self.back = None

    def _begin_second(self, segment, now_s):
        """A reverse that must come about: wanted for long enough, of a car that stands, with nothing wrong."""
        case = self.case
        late_s = case.odometry.delay_s + max((fault.value for fault in case.faults if fault.name == ODOMETRY_LATE),
                                             default=0.0)
        is_begun = case.script[self.index - 1].want == SECOND  # a pull that goes on, whose hand trembles
        is_due = (segment.want == SECOND and not is_begun and segment.end_s - now_s >= 1.5 + min(0.4, late_s)
                  and abs(self.car.wheel_mps) < 0.05 and abs(9.81 * case.car.slope) < case.car.drag_mps2
                  and case.group != "wrong" and case.esc.kind != FORWARD_ONLY and self.esc.is_on
                  and self.away_ns is None and not self.power and not self.reversals and self._is_untroubled()
                  and (not segment.stick or self._drives(segment.stick)))
        self.second = [self.now_ns, self.index, False] if is_due else None

    def _drives(self, stick):
        """Whether a pull of the stick, scaled, is beyond the ESC's dead band."""
        return shaped(-stick, StickConfig().deadband, 0.0) * self.case.human_scale > PULL_MIN

    def _is_untroubled(self):
        """Whether nothing that must be re-armed or that arms the ESC anew has gone wrong since the last release."""
        troubles = [at_ns for name, at_ns in self.latest_ns.items() if name not in (ODOMETRY_LATE, ODOMETRY_LOST)]
        return max(troubles, default=0) < self.released_ns - S

    def _end_of_second(self):
        if self.second:
            self.wanted += 1
            self.got += self.second[2]
            if self.story is not None and not self.second[2]:
                self.story.append("        a wanted reverse did not come about")
        self.second = None

    def _tell(self, now_s, segment, active):
        odometry, at_ns = self.last_odometry
        state = "dead" if self.control is None else "stalled" if self.away_ns is not None else ""
        self.story.append(
            f"{now_s:7.3f} {segment.want:6} {'deadman' if segment.deadman else '-':7} {segment.mode[:4]} stick "
            f"{segment.stick:+.2f} value {'-' if segment.value is None else f'{segment.value:+.1f}':5} asked "
            f"{0.0 if self.duty is None else (self.duty - NEUTRAL) / SPAN:+.2f} held {self.pulse:+.2f} "
            f"{self.esc.motor:8} {self.esc.level:.2f} car {self.car.speed_mps:+.2f} odometry {odometry:+.2f} "
            f"({(self.now_ns - at_ns) / S:.2f} s ago) "
            f"{state or self.decision and self.decision.esc.state} {', '.join(active)}"
            f"{' REVERSAL' if self.back_ns is not None and self.back else ''}")


class _Even:
    """In the place of a random generator: the middle, so that two versions' stops are compared under equal delays."""

    @staticmethod
    def randrange(low, high=None):
        return low // 2 if high is None else (low + high) // 2

    @staticmethod
    def uniform(low, high):
        return (low + high) / 2

    @staticmethod
    def gauss(mean, _sigma):
        return mean

    @staticmethod
    def random():
        return 0.5


def _channels(esc):
    """The board's channels: neutral as the timeout value of the ESC's, and a short time for pulls of most kinds."""
    brakes_first = esc["profile"] == BTR and esc.get("profile_measured", False)
    forgets_ms = round(1000 * esc.get("reverse_after_neutral_s", 0.0))
    config = ChannelConfig(timeout_value=NEUTRAL, pulls=-1, brakes_first=brakes_first, forgets_ms=forgets_ms)
    return [config if channel == CHANNEL else ChannelConfig() for channel in range(16)]
