"""A random walk of the parts alone: persons, planner, the cores as their nodes wire them, servo board, ESC and car.

A step is a message that arrives, a timer, or something that a person, a fault or the clock does. ``Goals`` judges.

    python3 -m walks.cores SEED [STEPS]    # in test, with PYTHONPATH=../src: what a seed does
"""
from __future__ import annotations

import heapq
import itertools
import math
import random
import sys
from collections import deque
from dataclasses import replace
from typing import Any, Callable

from adversary.car_model import CarModel, CarSpec
from adversary.esc_model import BACKWARD, FORWARD, KINDS, EscModel, EscSpec

from car_interface.interlock.motion_interlock import InterlockConfig
from car_interface.pca9685.channels import ChannelConfig, Channels
from car_interface.planner.messages import PlannerRequest, Refusal
from car_interface.planner.source_arbiter import SourceArbiter
from car_interface.steering.arbiter import SteeringArbiter, SteeringArbiterConfig
from car_interface.steering.calibration import SteeringCalibration
from car_interface.teleop.gamepad import GamepadConfig
from car_interface.teleop.handover import Handover
from car_interface.throttle.arbiter import ThrottleArbiterConfig
from car_interface.throttle.board_watch import BoardConfig
from car_interface.throttle.calibration import ThrottleCalibration
from car_interface.throttle.control import ThrottleControl
from car_interface.throttle.esc_config import EscConfig
from car_interface.throttle.limits import DriveLimits, ThrottleLimits
from walks.goals import BOTH, ESC, MS, SERVO, Goals

TICK_NS = 20 * MS
START_NS = 1000 * 1000 * MS
STOOD_STILL_NS = 500 * MS  # a node that stood still for so long obeys nothing that came meanwhile: docs/safety.md
CENTER, NEUTRAL, SPAN = 5100, 4915, 1639
LIMIT_MPS = 2.5
PAD, PHONE = "pad", "phone"
NODES = ("teleop", "planner", "turn_arb", "throttle_arb")
STOPS = ("e_stop", "phone/e_stop")
# What a dead node must stop, and within which time, by the page.
DEAD = {"teleop": (BOTH, 0.51), "turn_arb": (BOTH, 0.27), "throttle_arb": ((ESC,), 0.25)}
# What must stop while nothing arrives on a link, within which time, and whether to be re-armed.
LOST = {"human>turn": (BOTH, 0.51, True), "human>throttle": ((ESC,), 0.51, True), "steer": ((SERVO,), 0.51, False),
        "throt": ((ESC,), 0.51, False), "mode": ((ESC,), 0.51, False), "state": ((ESC,), 0.27, False),
        "output": ((ESC,), 0.51, False), "servo command": ((SERVO,), 0.25, False), "ESC command": ((ESC,), 0.25, False),
        "e_stop>turn": (BOTH, 1.01, True), "e_stop>throttle": ((ESC,), 1.01, True),
        "phone/e_stop>turn": (BOTH, 1.01, True), "phone/e_stop>throttle": ((ESC,), 1.01, True)}
DEADMAN = ["human>turn", "human>throttle"]
ODD = (math.nan, math.inf, -math.inf, 1e9, -1e9)
# On average, between what persons and faults do: at leisure (even seeds) each shows, in a hurry (odd ones) they meet.
ACT_NS = (250 * MS, 60 * MS)
IN_TURN_NS = 150 * MS  # a command that was replaced so lately may still be the servo's
DELAY_MS = 5


def _steering():
    return SteeringCalibration(servo_left=3800, servo_center=CENTER, servo_right=6700, servo_channel=SERVO,
                               radius_axis_m=[1, 2, 5, 20, 300], left_duties=[3800, 3830, 3860, 4400, CENTER],
                               right_duties=[6700, 6650, 6450, 5900, CENTER])


class Walk:
    """One walk; ``run`` takes steps, and ``goals.found`` has what was violated."""

    def __init__(self, seed: int):
        self.rng = random.Random(f"walk {seed}")
        kind = self.rng.choice(KINDS)
        self._profile = {"profile": kind, "profile_measured": self.rng.random() < 0.5}
        if self.rng.random() < 0.2:
            self._profile = {"profile": "unverified"}
        self._act_ns = ACT_NS[seed % 2]
        self.esc, self.car = EscModel(EscSpec(kind)), CarModel(CarSpec())
        self.goals = Goals(LIMIT_MPS)
        self.now_ns, self.steps, self._number = START_NS, 0, 0
        self._events: list = []
        self._lives = dict.fromkeys(NODES, 0)
        self._away: dict[str, tuple[int, list]] = {}  # since when a node stands still, and what has arrived since
        self._dead: set[str] = set()
        self._arrivals: dict[str, int] = {}
        self._heard: set[str] = set()  # e-stops' links on which something arrived since the arbiter's start
        self._loses: dict[str, float] = {}
        self._delays: dict[str, int] = {}
        self._hands = {PAD: ["", 0.0, 0.0], PHONE: ["", 0.0, 0.0]}
        self._silent: set[str] = set()  # hands and e-stop buttons that send nothing
        self._on = dict.fromkeys(STOPS, False)
        self._speed_mps, self._radius_m, self._plans = 0.0, 2.0, True
        self._turns: deque = deque(maxlen=64)  # (when it was replaced, counts) of turn_arb's commands
        self._turn: int | None = None
        self._commanded_ns = [START_NS, START_NS]
        self._duty: dict[str, Any] = {}
        for node in NODES:
            self._start(node)
        esc = ChannelConfig(timeout_value=NEUTRAL, pulls=-1, brakes_first=kind == "brake_then_reverse"
                            and self._profile.get("profile_measured", False))
        servo = ChannelConfig(timeout_value=CENTER)
        self.board = Channels([servo, esc] + [ChannelConfig()] * 14)
        self._held: list[int] = []
        for period_ms, act in ((40, self._tick_teleop), (20, self._tick_turn), (20, self._tick_throttle),
                               (50, self._tick_planner), (20, self._pulse), (40, self._odometry), (40, self._joy),
                               (50, self._phone), (200, self._e_stops), (100, self._report), (20, self._expire)):
            self._repeat(period_ms * MS, act, self.rng.randrange(period_ms) * MS)
        self._push(START_NS + 1500 * MS, self._act)

    def run(self, steps: int) -> Goals:
        for _ in range(steps):
            self.steps += 1
            self.now_ns, _, act, arguments = heapq.heappop(self._events)
            act(*arguments)
        return self.goals

    # --- events, nodes and links ---

    def _push(self, at_ns, act, *arguments):
        self._number += 1
        heapq.heappush(self._events, (at_ns, self._number, act, arguments))

    def _repeat(self, period_ns, act, phase_ns=0):
        def again():
            self._push(self.now_ns + period_ns, again)
            act()
        self._push(self.now_ns + phase_ns, again)

    def _start(self, node):
        rearm = InterlockConfig(grant_at_start=False)
        if node == "teleop":
            self.teleop = Handover(GamepadConfig(steer_axis=0, throttle_axis=1, manual_button=0, autonomous_button=1))
            self._sent = None
        elif node == "planner":
            self.planner = SourceArbiter("drive", 0.5)
        elif node == "turn_arb":
            self.turn = SteeringArbiter(_steering(), SteeringArbiterConfig(interlock=rearm))
        else:
            limits = DriveLimits(max_speed_mps=LIMIT_MPS)
            config = ThrottleArbiterConfig(interlock=rearm, board=BoardConfig())
            config = replace(config, stick=replace(config.stick, human_scale=0.6))
            table = ThrottleCalibration(channel=ESC, value_axis=[-5.0, 0.0, 3.0], duty_table=[3277, NEUTRAL, 6554],
                                        neutral=NEUTRAL)
            self.throttle = ThrottleControl(table, config, EscConfig(arming_time_s=0.5, **self._profile),
                                            ThrottleLimits(human=limits, planner=limits))
        self._duty.pop(node, None)

    def _send(self, link, node, handler: Callable, *arguments):
        """Send a message to a node's handler, in order; the handler gets its arrival, too."""
        if self.rng.random() < self._loses.get(link, 0.0):
            return
        delay_ns = self._delays.get(link) or self.rng.randrange(DELAY_MS) * MS
        at_ns = self._arrivals[link] = max(self.now_ns + delay_ns, self._arrivals.get(link, 0))
        self._push(at_ns, self._arrive, node, self._lives.get(node), handler, arguments, link)

    def _arrive(self, node, life, handler, arguments, link=""):
        if node in self._dead or life != self._lives.get(node):
            return
        self._heard.add(link)
        if node in self._away:
            self._away[node][1].append((handler, arguments, self.now_ns))
        else:
            handler(*arguments, self.now_ns)

    def _is_here(self, node):
        return node not in self._dead and node not in self._away

    # --- teleop_logi ---

    def _joy(self):
        if PAD not in self._silent:
            deadman, steering, throttle = self._hands[PAD]
            self._send("joy", "teleop", self._on_joy, [steering, throttle],
                       [deadman == "manual", deadman == "autonomous"])

    def _phone(self):
        if PHONE not in self._silent:
            deadman, steering, throttle = self._hands[PHONE]
            self._send("phone/joy", "teleop", self._on_phone, [steering, throttle],
                       [deadman == "manual", deadman == "autonomous", 0, 0])

    def _on_joy(self, axes, buttons, now_ns):
        self._teleop_changed(now_ns)
        self.teleop.gamepad.update(axes, buttons, now_ns)
        self._teleop_changed(now_ns)

    def _on_phone(self, axes, buttons, now_ns):
        self._teleop_changed(now_ns)
        self.teleop.phone.update(axes, buttons, now_ns)
        self._teleop_changed(now_ns)

    def _teleop_changed(self, now_ns):
        requests = self.teleop.requests(now_ns)
        if self._sent is None or requests.differs_by != self._sent.differs_by:
            self._publish(requests)

    def _tick_teleop(self):
        if self._is_here("teleop"):
            self._publish(self.teleop.requests(self.now_ns), self.rng.random() < 0.4)

    def _publish(self, requests, has_mode=False):
        is_new = self._sent is None or requests.mode != self._sent.mode
        self._sent = requests
        human = requests.human_in_loop
        if not human:
            self._send_human(False)
        if is_new or has_mode:
            self._send("mode", "throttle_arb", self._on_throttle, "update_mode", requests.mode)
        self._send("steer", "turn_arb", self._on_turn, "update_teleop", requests.steering)
        self._send("throt", "throttle_arb", self._on_throttle, "update_teleop", requests.throttle)
        if human:
            self._send_human(True)

    def _send_human(self, human):
        self._send("human>turn", "turn_arb", self._on_turn, "update_human", human)
        self._send("human>throttle", "throttle_arb", self._on_throttle, "update_human", human)

    # --- the planner, and the converter ---

    def _tick_planner(self):
        now_ns = self.now_ns
        if not self._is_here("planner"):
            return
        if self._plans:
            self.planner.update(PlannerRequest(self._radius_m, self._speed_mps), now_ns)
        decision = self.planner.decide(now_ns)
        if decision.radius_m:
            self._send("radius", "turn_arb", self._on_turn, "update_planner", decision.radius_m)
        if decision.request is not None:
            value = max(-5.0, min(3.0, 2.0 * (decision.request.speed_mps - self.car.wheel_mps)))
            self._send("value", "throttle_arb", self._on_value, value)

    # --- arbiters ---

    def _on_turn(self, update, value, now_ns):
        getattr(self.turn, update)(value, now_ns)
        self._decide_turn(now_ns, False)

    def _on_teleop_state(self, now_ns):
        self.turn.explain_human(True, "", now_ns)
        self._decide_turn(now_ns, False)

    def _on_throttle(self, update, value, now_ns):
        getattr(self.throttle.arbiter, update)(value, now_ns)
        if value is not self._duty.get(update):  # the node decides on changes
            self._duty[update] = value
            self._decide_throttle(self.now_ns, False)

    def _on_value(self, value, now_ns):
        self.throttle.update_planner(value, now_ns)

    def _tick_turn(self):
        if self._is_here("turn_arb"):
            self._decide_turn(self.now_ns, True)

    def _tick_throttle(self):
        if self._is_here("throttle_arb"):
            self._decide_throttle(self.now_ns, True)

    def _decide_turn(self, now_ns, repeats):
        decision = self.turn.decide(now_ns)
        is_new = self._duty.get("turn_arb") != (decision.duty, decision.source)
        if not (is_new or repeats):
            return
        self._duty["turn_arb"] = decision.duty, decision.source
        self.goals.explain(now_ns, decision.duty == CENTER, decision.cause)
        counts = int(decision.duty / 16 + 0.5)
        if counts != self._turn:
            self._turns.append((self.now_ns, self._turn))
            self._turn = counts
        self._send("servo command", "board", self._command, SERVO, decision.duty)
        if is_new or self.rng.random() < 0.3:
            self._send("state", "throttle_arb", self._on_state, decision)

    def _on_state(self, decision, now_ns):
        arbiter = self.throttle.arbiter
        arbiter.update_steering(decision.source, decision.reason, now_ns)
        arbiter.update_steering_command(SERVO, decision.duty, now_ns)
        self.throttle.update_turn(decision.asked_radius_m, decision.max_speed_mps)
        self._decide_throttle(self.now_ns, False)

    def _decide_throttle(self, now_ns, repeats):
        decision = self.throttle.decide(now_ns)
        if repeats or self._duty.get("throttle_arb") != decision.duty:
            self._duty["throttle_arb"] = decision.duty
            self.goals.explain(now_ns, decision.duty == NEUTRAL, decision.arbitration.cause and decision.esc.cause)
            self._send("ESC command", "board", self._command, ESC, decision.duty)

    # --- board, ESC and car ---

    def _command(self, channel, duty, now_ns):
        vector = [-1] * 16
        vector[channel] = duty
        self.board.expire(now_ns)
        self.board.command(vector, now_ns)
        self._commanded_ns[channel] = now_ns
        self._look()

    def _expire(self):
        self.board.expire(self.now_ns)
        self._look()
        servo, esc = self._sides()
        for channel, moves in ((SERVO, servo), (ESC, esc)):
            if moves:
                self.goals.outlives(self.now_ns, channel, self.now_ns - self._commanded_ns[channel])

    def _sides(self):
        servo, esc = self.board.targets[:2]
        center, neutral = int(CENTER / 16 + 0.5), int(NEUTRAL / 16 + 0.5)
        return (servo < center) - (servo > center), (esc > neutral) - (esc < neutral)

    def _look(self, drives=0):
        targets = self.board.targets[:2]
        is_together = targets[SERVO] == self._turn or any(
            counts == targets[SERVO] and self.now_ns - at_ns <= IN_TURN_NS for at_ns, counts in self._turns)
        self.goals.look(self.now_ns, *self._sides(), is_together, drives, self.car.speed_mps)
        if targets != self._held:
            self._held = targets
            self._report()

    def _report(self):
        self._send("output", "throttle_arb", self.throttle.update_output,
                   [counts * 16 for counts in self.board.targets])

    def _pulse(self):
        pulse = (self.board.targets[ESC] * 16 - NEUTRAL) / SPAN
        self.esc.step(pulse, self.car.wheel_mps, 0.02)
        self.car.step(self.esc.motor, self.esc.level, 0.0, 0.02)
        is_backward = self.esc.motor == BACKWARD and self.car.wheel_mps <= 0.05
        self._look(-1 if is_backward else int(self.esc.motor == FORWARD))

    def _odometry(self):
        self._send("odometry", "throttle_arb", self._on_odometry, self.car.wheel_mps, self.now_ns)
        self._send("odometry>turn", "turn_arb", self.turn.limiter.speed.update, self.car.wheel_mps)

    def _on_odometry(self, speed_mps, stamp_ns, now_ns):
        self.throttle.update_odometry(speed_mps, now_ns, now_ns - stamp_ns)

    # --- e-stops ---

    def _e_stops(self):
        for name in STOPS:
            if name not in self._silent:
                update = {"e_stop": "update_e_stop"}.get(name, "update_phone_e_stop")
                self._send(f"{name}>turn", "turn_arb", self._on_turn, update, self._on[name])
                self._send(f"{name}>throttle", "throttle_arb", self._on_throttle, update, self._on[name])

    # --- what persons and faults do ---

    def _act(self):
        rng = self.rng
        self._push(self.now_ns + round(rng.expovariate(1.0) * self._act_ns), self._act)
        act = rng.choices((self._hold, self._let_go, self._move, self._plan, self._push_stop, self._trouble),
                          (30, 6, 40, 8, 1, 6))[0]
        act()

    def _set_hand(self, hand, deadman, steering, throttle):
        self._hands[hand] = [deadman, steering, throttle]
        self.goals.touch(hand, deadman, steering, throttle, self.now_ns)
        if hand in self._silent:
            self._lack(hand)
            return
        (self._joy if hand == PAD else self._phone)()

    def _hold(self):
        rng = self.rng
        if any(deadman for deadman, *_ in self._hands.values()):
            return
        hand = PHONE if rng.random() < 0.25 and PAD not in self._silent else PAD
        sticks = (0.0, 0.0) if rng.random() < 0.9 else (rng.uniform(-1, 1), rng.uniform(-1, 1))
        self._set_hand(hand, rng.choice(("manual", "autonomous")), *sticks)

    def _let_go(self):
        for hand, (deadman, *_) in self._hands.items():
            if deadman:
                sticks = (0.0, 0.0) if self.rng.random() < 0.8 else self._hands[hand][1:]
                self._set_hand(hand, "", *sticks)

    def _move(self):
        rng = self.rng
        for hand, (deadman, *sticks) in self._hands.items():
            if deadman:
                if rng.random() < 0.5:
                    sticks[0] = rng.choice((0.0, rng.uniform(-1, 1), rng.uniform(-1, 1)))
                else:
                    sticks[1] = rng.choice((0.0, 0.0, rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(-1, 0)))
                self._set_hand(hand, deadman, *sticks)

    def _plan(self):
        rng = self.rng
        self._speed_mps, self._radius_m = rng.choice((0.0, 1.0, 2.0, 4.0)), rng.choice((2.0, -2.0, 9.0, math.inf))
        self._plans = rng.random() < 0.9

    def _push_stop(self):
        name = self.rng.choice(STOPS)
        self._set_stop(name, True)
        self._push(self.now_ns + self.rng.randrange(20, 3000) * MS, self._set_stop, name, False)

    def _set_stop(self, name, is_on):
        self._on[name] = is_on
        if is_on and name not in self._silent:
            self.goals.stop(name, self.now_ns)
        elif not is_on:
            self.goals.clear(name, self.now_ns)
        self._e_stops()

    # --- faults ---

    def _trouble(self):
        rng = self.rng
        lasts_ns = (rng.randrange(5, 500) if rng.random() < 0.5 else rng.randrange(600, 3000)) * MS
        rng.choice((self._lose, self._lose, self._delay, self._silence, self._stall, self._kill, self._odd))(lasts_ns)

    def _rough(self, lasts_ns, but=""):
        self.goals.rough(self.now_ns + lasts_ns + 300 * MS, but)

    def _lose(self, lasts_ns):
        link = self.rng.choice([*LOST, *DEADMAN * 3] if self.rng.random() < 0.7 else sorted(self._arrivals))
        if link in self._loses:
            return
        self._loses[link] = self.rng.choice((1.0, 1.0, 0.3))
        name = f"{link} lost"
        is_in_use = link.split(">")[0] not in STOPS or link in self._heard  # R15: never received
        if self._loses[link] == 1.0 and link in LOST and is_in_use:
            actuators, within_s, rearms = LOST[link]
            self.goals.stop(name, self.now_ns, within_s, actuators, rearms)
        self._rough(lasts_ns, name)
        self._push(self.now_ns + lasts_ns, self._find, link)

    def _find(self, link):
        del self._loses[link]
        self.goals.clear(f"{link} lost", self.now_ns)

    def _delay(self, lasts_ns):
        link = self.rng.choice(sorted(self._arrivals))
        if link in self._delays:
            return
        self._delays[link] = self.rng.randrange(10, 200) * MS
        self._rough(lasts_ns)
        self._push(self.now_ns + lasts_ns, self._delays.pop, link, None)

    def _silence(self, lasts_ns):
        who = self.rng.choice((PAD, PHONE, *STOPS))
        if who in self._silent or who in STOPS and self._on[who]:
            return
        self._silent.add(who)
        self._lack(who)
        self._push(self.now_ns + lasts_ns, self._return, who)

    def _lack(self, who):
        """Note what the silence of a hand or an e-stop button must stop. A hand that let go gives way to the other."""
        name = f"{who} silent"
        if who in STOPS:  # R15: a node that has never received it doesn't miss it
            actuators = BOTH if f"{who}>turn" in self._heard else (ESC,) if f"{who}>throttle" in self._heard else ()
            self.goals.stop(name, self.now_ns, 1.01, actuators)
        elif self._hands[who][0]:
            self.goals.stop(name, self.now_ns, 0.27)
            self._rough(0, but=name)
        else:
            self._rough(0)
            self.goals.clear(name, self.now_ns)

    def _return(self, who):
        self._silent.discard(who)
        self.goals.clear(f"{who} silent", self.now_ns)
        if self._on.get(who):
            self.goals.stop(who, self.now_ns)
        self._rough(0)

    def _stall(self, lasts_ns):
        node = self.rng.choice(NODES)
        if not self._is_here(node):
            return
        self._away[node] = self.now_ns, []
        self._kept(node, lasts_ns, lasts_ns > STOOD_STILL_NS + TICK_NS)
        self._push(self.now_ns + lasts_ns, self._thaw, node)

    def _thaw(self, node):
        since_ns, arrived = self._away.pop(node)
        if self.now_ns - since_ns >= STOOD_STILL_NS:
            core = {"teleop": self.teleop, "planner": self.planner, "turn_arb": self.turn,
                    "throttle_arb": self.throttle}[node]
            core.mark_stale(*() if node in ("teleop", "planner") else (self.now_ns,))
            return
        for handler, arguments, at_ns in arrived:
            handler(*arguments, at_ns)

    def _kill(self, lasts_ns):
        node = self.rng.choice(NODES)
        if not self._is_here(node):
            return
        self._dead.add(node)
        self._lives[node] += 1
        self._kept(node, lasts_ns, True)
        if node == "turn_arb":
            self._turns.append((self.now_ns, self._turn))
            self._turn = None
        self._push(self.now_ns + lasts_ns, self._restart, node)

    def _restart(self, node):
        self._dead.discard(node)
        self._start(node)
        if node in ("turn_arb", "throttle_arb", "teleop") and "teleop" not in self._dead:
            # teleop_logi's state, which is latched
            self._push(self.now_ns, self._arrive, "turn_arb", self._lives.get("turn_arb"),
                       self._on_teleop_state, ())
            self._push(self.now_ns, self._arrive, "throttle_arb", self._lives.get("throttle_arb"),
                       self.throttle.arbiter.explain_human, (True, ""))
        if node in ("turn_arb", "throttle_arb"):
            self._heard -= {f"{name}>{node[:-4]}" for name in STOPS}
        for name, link in itertools.product(STOPS, ("turn", "throttle")):
            if name in self._silent or self._loses.get(f"{name}>{link}"):  # R15: never received
                for each in (name, f"{name} silent", f"{name}>{link} lost"):
                    self.goals.waive(each)

    def _kept(self, node, lasts_ns, rearms):
        """Note that a node is away: whether it must be re-armed, and that others have to wait for it."""
        name = f"{node} away {self.steps}"
        actuators, within_s = DEAD.get(node, ((), 0.0))
        if rearms and actuators:
            self.goals.stop(name, self.now_ns, within_s, actuators, until_press=True)
        self._rough(lasts_ns, name)

    def _odd(self, lasts_ns):
        rng = self.rng
        odd = rng.choice(ODD)
        link, node, handler, *arguments = rng.choice((
            ("joy", "teleop", self._on_joy, [odd, odd], [bool(self._hands[PAD][0]), 0]),
            ("joy", "teleop", self._on_joy, [0.0], [1]),
            ("steer", "turn_arb", self._on_turn, "update_teleop", odd),
            ("throt", "throttle_arb", self._on_throttle, "update_teleop", odd),
            ("mode", "throttle_arb", self._on_throttle, "update_mode", rng.choice(("", "x", "manual\0"))),
            ("radius", "turn_arb", self._on_turn, "update_planner", odd),
            ("value", "throttle_arb", self._on_value, odd),
            ("odometry", "throttle_arb", self._on_odometry, odd, self.now_ns - rng.choice((0, 10 ** 12, -10 ** 12))),
            ("plan", "planner", self.planner.update, Refusal("request refused", "odd", rng.random() < 0.5))))
        if link == "joy":
            self.goals.distrust()
        self._send(link, node, handler, *arguments)
        self._rough(0)


def main() -> None:
    seed, steps = int(sys.argv[1]), int((sys.argv[2:] or ["100000"])[0])
    walk = Walk(seed)
    walk.run(steps)
    print(*walk.goals.found, sep="\n")
    print(f"seed {seed}: {steps} steps, {(walk.now_ns - START_NS) / 1e9:.0f} s, {len(walk.goals.found)} violations")


if __name__ == "__main__":
    main()
