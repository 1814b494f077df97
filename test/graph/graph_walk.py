"""A random walk of the whole graph: a person, a planner, and the faults of ``single_faults``, several at a time.

A step is one thing that happens (a message, a fault, a stall, a restart, a release), or none, and 1 to 8 ms. ``Goals``
judges by what the person touches and by servo, ESC and car.
"""
from __future__ import annotations

import random
from functools import partial

from geometry_msgs.msg import Twist
from std_msgs.msg import Bool, Float32, Int32MultiArray, String
from walks.goals import MS, Goals

from car import CENTER, CONTROL, ESC, ESC_NEUTRAL, STEERING
from inputs import control, odometry
from single_faults import (
    ESCS,
    LINKS,
    NAN,
    NODES,
    OTHERS,
    PLANNER,
    VECTOR,
    Drive,
    hold_bus,
    inject,
    nacks,
    remove_board,
    return_board,
    set_clock,
)

BOUNDS_MS = 5, 500, 600, 2500  # of short and of long faults
ACT, FAULT, ODD = 0.03, 0.004, 0.001  # shares of the steps
GUARD_NS = 1500 * MS  # until a board's guard that was lost is replaced, surely
PULL_LASTS_NS = 1000 * MS  # until the board is found again or its guard ends the pull, and until the car's answer
IN_TURN_NS = 150 * MS  # a command that was replaced so lately may still be the servo's
BACKWARD_MPS = -0.05
SLOW_MPS = 0.8  # the person doesn't pull below it: that may want reverse
REARMS = {"joy", "human_in_loop", "e_stop"}  # links whose loss takes a press of the deadman
ODDS = (("/joy", lambda drive: type(drive.car.joy_now)()), (VECTOR, lambda drive: Int32MultiArray(data=[6700] * 15)),
        ("/teleop_logi/tele_steer_req", lambda drive: Float32(NAN)),
        ("/teleop_logi/tele_throt_req", lambda drive: Float32(NAN)),
        ("/teleop_logi/mode", lambda drive: String("x")),
        ("/av_turnrad_req", lambda drive: Float32(NAN)), ("/av_speed_req", lambda drive: Float32(NAN)),
        (CONTROL, lambda drive: control(NAN)), ("/odom", lambda drive: odometry(NAN)),
        ("/cmd_vel", lambda drive: Twist()))


def ways(link):
    return link.topic, link.sender, link.receiver


class GraphWalk:
    """One walk; ``run`` takes steps, and ``goals.found`` has what was violated."""

    def __init__(self, seed: int):
        self.rng = random.Random(f"graph walk {seed}")
        self.drive = Drive(self.rng.choice(("manual", "autonomous")), self.rng.choice(list(ESCS)))
        self.graph, self.car = self.drive.graph, self.drive.car
        self.graph.record(VECTOR)
        self.goals, self.steps = Goals(), 0
        self._speed_mps, self._seen = 0.0, len(self.car.board.changes) - 1
        self._turns: list = []
        self._turn = None
        self._busy: set[str] = set()
        self._stopped = self._silent = False
        self._board_busy_until_ns = 0
        self._hold(self.drive.mode.deadman, 0.0, 0.0)
        self.graph.run(0.5)

    def run(self, steps: int) -> Goals:
        rng = self.rng
        for _ in range(steps):
            self.steps += 1
            draw = rng.random()
            if draw < FAULT:
                self._fault()
            elif draw < FAULT + ACT:
                self._act()
            elif draw < FAULT + ACT + ODD:
                self._odd()
            elif draw < 0.1:
                self._plan()
            self.graph.run(rng.randrange(1, 9) / 1000)
            self._look()
        return self.goals

    @property
    def _now_ns(self):
        return self.graph.now_ns

    def _rough(self, lasts_s, but=""):
        self.goals.rough(self._now_ns + round(lasts_s * 1e9) + 300 * MS, but)

    # --- the car ---

    def _look(self):
        """Judge each change of the pins since the last step, and the end of this one."""
        for record in self.graph.recorded[VECTOR]:
            duty = record.message.data[STEERING]
            if record.sender == "/turn_arb" and duty != -1:
                counts = int(duty / 16 + 0.5)
                if counts != self._turn:
                    self._turns.append((record.at_ns, self._turn))
                    self._turn = counts
        truths = self.graph.recorded["/car_sim/truth"]
        if truths:
            self._speed_mps = truths[-1].message.twist.twist.linear.x
        for records in self.graph.recorded.values():
            records.clear()
        changes = self.car.board.changes
        self._turns = [each for each in self._turns if self._now_ns - each[0] <= IN_TURN_NS]
        for at_ns, counts in [*changes[self._seen + 1:], (self._now_ns, changes[-1][1])]:
            servo, esc = counts[STEERING], counts[ESC]
            side = bool(servo) * ((servo < CENTER) - (servo > CENTER))
            is_together = servo == self._turn or any(servo == was for _, was in self._turns)
            drives = -1 if self._speed_mps < BACKWARD_MPS else 0
            self.goals.look(at_ns, side, bool(esc) * ((esc > ESC_NEUTRAL) - (esc < ESC_NEUTRAL)), is_together, drives,
                            self._speed_mps)
        self.car.board.changes[:] = changes[-1:]
        self._seen = 0
        self.graph.log.clear()

    def _hold_pull(self):
        counts = self.car.board.changes[-1][1]
        if 0 < counts[ESC] < ESC_NEUTRAL:
            self.goals.hold_pull(self._now_ns + PULL_LASTS_NS)

    # --- person and planner ---

    def _hold(self, deadman, steering, throttle):
        self._hand = deadman, steering, throttle
        self.goals.touch("pad", deadman, steering, throttle, self._now_ns)
        self.car.pad(**{deadman: True} if deadman else {}, steering=steering, throttle=throttle)
        if not self._silent:
            self.graph.publish("/joy", self.car.joy_now, "/joy_node")
        elif deadman:
            self.goals.stop("joy silent", self._now_ns, 0.27)

    def _act(self):
        rng, (deadman, steering, throttle) = self.rng, self._hand
        draw = rng.random()
        if draw < 0.04:
            self._push_stop()
        elif not deadman:
            if draw < 0.5:
                self._hold(rng.choice(("manual", "autonomous")), 0.0, 0.0)
        elif draw < 0.12:
            self._hold("", 0.0, 0.0)
        elif draw < 0.5:
            self._hold(deadman, rng.choice((0.0, rng.uniform(-1, 1))), throttle)
        else:
            least = -1.0 if self._speed_mps > SLOW_MPS else 0.0
            self._hold(deadman, steering, rng.choice((0.0, rng.uniform(0, 1), rng.uniform(least, 1))))

    def _push_stop(self):
        if not self._stopped:
            self._stopped = True
            self.goals.stop("e_stop", self._now_ns)
            self.graph.hold("/e_stop", Bool(True), 10)
            self.graph.after(self.rng.uniform(0.05, 2.5), self._end_stop)

    def _end_stop(self):
        self._stopped = False
        self.goals.clear("e_stop", self._now_ns)
        self.graph.hold("/e_stop", Bool(False), 10)

    def _plan(self):
        rng = self.rng
        topic, message = rng.choice((("/av_turnrad_req", Float32(rng.choice((2.0, -2.0, 8.0)))),
                                     ("/av_speed_req", Float32(rng.uniform(0.0, 2.5)))))
        if rng.random() < 0.1:
            self.graph.hold(topic, message, 20, sender="/planner")
        else:
            self.graph.publish(topic, message, "/planner")

    def _odd(self):
        topic, make = self.rng.choice(ODDS)
        self.graph.publish(topic, make(self.drive), "/joy_node" if topic == "/joy" else "/other")
        self.goals.distrust()
        self._rough(0)

    # --- faults ---

    def _fault(self):
        rng = self.rng
        low, high, longer, longest = BOUNDS_MS
        lasts_s = (rng.randrange(low, high) if rng.random() < 0.5 else rng.randrange(longer, longest)) / 1000
        rng.choice((self._link, self._link, self._node, self._node, self._silence, self._device))(lasts_s)

    def _busily(self, name, lasts_s, end):
        """Have one fault of a name at a time; ``end`` ends it."""
        self._busy.add(name)

        def over():
            self._busy.discard(name)
            end()
        self.graph.after(lasts_s, over)

    def _link(self, lasts_s):
        stopping = [each for each in LINKS.items() if each[1].stops and each[1].takes != PLANNER]
        name, link = self.rng.choice(stopping if self.rng.random() < 0.7 else list(LINKS.items()))
        if name in self._busy or name.startswith("phone"):
            return
        how = self.rng.choice(("lost", "lost", "gaps", "late", "twice"))
        if how == "lost":
            self.graph.link(*ways(link), loses=lambda data: True)
            self._lose(f"{name} lost", name, link)
        elif how == "gaps":
            self.graph.link(*ways(link), loses=lambda data: self.rng.random() < 0.3)
        elif how == "late":
            self.graph.link(*ways(link), delay_s=self.rng.uniform(0.01, 0.2))
        else:
            self.graph.link(*ways(link), copies=2)
        self._rough(lasts_s, f"{name} lost")
        self._busily(name, lasts_s, partial(self._mend, name, link))

    def _lose(self, stop, name, link):
        # The ESC drives again, for as long as G3 allows, after a release in which turn_arb commanded center, too.
        stops = {STEERING: link.stops[STEERING]} if name == "steering command" else link.stops
        if stops and link.takes != PLANNER and (name != "joy" or self._hand[0]):
            self.goals.stop(stop, self._now_ns, max(stops.values()) + 0.02, tuple(stops), rearms=name in REARMS)

    def _mend(self, name, link):
        self.graph.link(*ways(link))
        self.goals.clear(f"{name} lost", self._now_ns)
        if not any(each in self._busy for each in LINKS):
            self.graph._links.clear()

    def _silence(self, lasts_s):
        if self._silent:
            return
        self._silent = True
        self.car.joy(False)
        if self._hand[0]:
            self.goals.stop("joy silent", self._now_ns, 0.27)
        self._rough(lasts_s, "joy silent")
        self.graph.after(lasts_s, self._return)

    def _return(self):
        self._silent = False
        self.car.joy()
        self.goals.clear("joy silent", self._now_ns)

    def _node(self, lasts_s):
        names = [name for name, (_, _, takes, _) in NODES.items() if name != "phone_drive"
                 and (takes != PLANNER or self.rng.random() < 0.4)]
        name = self.rng.choice(names)
        if name in self._busy or name == "pca9685" and self._now_ns < self._board_busy_until_ns:
            return
        node, (_, stops, takes, rearms) = self.graph.nodes[f"/{name}"], NODES[name]
        is_board = name == "pca9685"
        how = self.rng.choice(("kill", "end", "stall", "frozen"))
        is_stalled = how in ("stall", "frozen")
        stop = f"{name} {how} {self.steps}"
        if takes != PLANNER and not (is_stalled and lasts_s < (0.3 if is_board else 0.52)):
            self.goals.stop(stop, self._now_ns, max(stops.values()) + 0.02, tuple(stops), rearms,
                            until_press=rearms)
        self._rough(lasts_s + is_board, stop)
        if is_board:
            self._board_busy_until_ns = self._now_ns + round(lasts_s * 1e9) + GUARD_NS
            self._hold_pull()
        if is_stalled:
            node.stall(lasts_s, frozen=how == "frozen")
        else:
            getattr(node, how)()
        if name == "turn_arb" and not is_stalled:
            self._turns.append((self._now_ns, self._turn))
            self._turn = None
        self._busily(name, lasts_s, partial(self._go_on, node, is_stalled, "" if rearms else stop))

    def _go_on(self, node, was_stalled, stop):
        if stop:
            self.goals.clear(stop, self._now_ns)
        if not was_stalled:
            node.start()
            for each in ("e_stop", "e_stop lost") if "e_stop" in self._busy else ():
                self.goals.waive(each)  # R15: never received
        self._rough(0)

    def _device(self, lasts_s):
        board = self.car.board
        name, make, rough_s = self.rng.choice((
            ("clock", set_clock(self.rng.choice((-1, 1))), 0.0), ("nacks", nacks(self.rng.choice((1, 5))), 0.5),
            ("bus", hold_bus, 0.5), ("brown-out", lambda drive: board.brown_out(), 0.6), ("power", None, 0.6),
            ("guard", OTHERS[self.rng.choice(("guard killed", "guard frozen"))].make, 0.0),
            ("Teensy", inject(*self.rng.choice((("unplug", 1.0), ("silence", 1.0), ("reboot", 0), ("scramble", 1.0)))),
             1.0)))
        if name in ("guard", "nacks", "bus", "power", "brown-out"):
            if "pca9685" in self._busy or self._now_ns < self._board_busy_until_ns:
                return
            self._board_busy_until_ns = self._now_ns + GUARD_NS
            if name in ("nacks", "bus"):
                self._hold_pull()
        if name == "power":
            remove_board(self.drive)
            self._board_busy_until_ns += round(lasts_s * 1e9)
            self._busily(name, lasts_s, lambda: return_board(self.drive))
            self._rough(lasts_s)
        elif name != "Teensy" or self.graph.nodes["/car_sim"].is_alive:
            make(self.drive)
        self._rough(rough_s)
