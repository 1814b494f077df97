"""A car that drives, one fault of it, and what a person does then; judged by servo, ESC and car alone.

The bounds are those of docs/safety_case.md, and share no constant with the nodes. A fault delays a person's stop by the
time-out of whoever waits for what is missing, one tick, and what the test puts on the links.
"""
from __future__ import annotations

import itertools
import math
import os
import random
from functools import partial
from types import MappingProxyType
from typing import Any, Callable, Iterable, Mapping, NamedTuple

from car_interface.msg import Float64Stamped
from std_msgs.msg import Bool, Float32, Float64, Int32MultiArray

from car import ADDRESS, CENTER, CONTROL, ESC, ESC_NEUTRAL, STEERING, THIRD, Car, config
from graph import NS_PER_S
from inputs import control, odometry
from phones import Network, Phone

MS = 1_000_000
TICK_S = 0.02  # of teleop_logi and of throttle_arb
LATE_S, LOST = 0.1, 0.3  # of a link: how late, and which part of its messages
UNDO_S = 0.7
SETTLE_S = 1.0 if os.environ.get("CAR_INTERFACE_ALL") else 0.25  # of what is judged after the last bound
TOGETHER_S = 0.54  # throttle without steering
NOISE_MPS = 0.03
BOTH = (STEERING, ESC)
NONE: Mapping[int, float] = MappingProxyType({})
HUMAN, PLANNER, PHONE = "human", "planner", "phone"


class Mode(NamedTuple):
    """Who steers and who drives, by which deadman."""

    steers: str
    drives: str
    deadman: str
    third_mode: str = "human_steering"


MODES = {
    "manual": Mode(HUMAN, HUMAN, "manual"), "autonomous": Mode(PLANNER, PLANNER, "autonomous"),
    "human_throttle": Mode(PLANNER, HUMAN, "third", "human_throttle"), "human_steering": Mode(HUMAN, PLANNER, "third"),
    PHONE: Mode(HUMAN, HUMAN, PHONE)}
# What is configured, and what the virtual ESC is.
ESCS = {"brake_then_reverse": "brake_then_reverse", "brake_becomes_reverse": "brake_becomes_reverse",
        "direct_reverse": "direct_reverse", "forward_only": "forward_only", "unverified": "direct_reverse"}
ACTIONS = ("nothing", "release", "e_stop", "pull")
MOMENTS = 20  # within the 100 ms of the slowest timer of the command path: at, just before and just after its ticks


class Kind(NamedTuple):
    """A fault.

    Attributes:
        make: called with the drive.
        undo: ends it after UNDO_S, under a deadman that is still held.
        timeout_s, delay_s: of a person's stop: of whoever waits in vain, and what the test puts on the links.
        stops: the time-out after which each pin must be at rest, by pin; of those whom ``takes`` names.
        lasts_s: how long they must be; until the end where the deadman must be released before they move.
        takes: the source, human or planner, whose pins these are; empty = whoever drives.
        modes, actions: in which it can be, and which it leaves the person.
        centers: it takes the steering alone, and the throttle goes on.
        holds: the board can't change its pulses, so a pull that may become reverse lasts: R2.
    """

    make: Callable[[Any], Any]
    undo: Callable[[Any], Any] | None = None
    timeout_s: float = 0.0
    delay_s: float = 0.0
    stops: Mapping[int, float] = NONE
    lasts_s: float = math.inf
    takes: str = ""
    modes: tuple[str, ...] = tuple(MODES)
    actions: tuple[str, ...] = ACTIONS
    centers: bool = False
    holds: bool = False


# --- links ---

class Link(NamedTuple):
    """Messages of a topic, of one sender, to one receiver (empty = any).

    Attributes:
        stops, takes: as of a ``Kind`` that loses all of them.
        timeout_s: likewise, of a person's stop; ``None`` = no person's stop goes this way.
    """

    topic: str
    sender: str = ""
    receiver: str = ""
    timeout_s: float | None = None
    stops: Mapping[int, float] = NONE
    takes: str = ""
    modes: tuple[str, ...] = tuple(MODES)


def both(timeout_s):
    return dict.fromkeys(BOTH, timeout_s)


GAMEPAD = tuple(mode for mode in MODES if mode != PHONE)
VECTOR = "/servo/cmdVector"
LINKS = {
    "joy": Link("/joy", timeout_s=0.25, stops=both(0.25), modes=GAMEPAD),
    "phone/joy": Link("/phone/joy", timeout_s=0.25, stops=both(0.25), modes=(PHONE,)),
    "phone/e_stop": Link("/phone/e_stop", timeout_s=1.0, stops=both(1.0), modes=(PHONE,)),
    "e_stop": Link("/e_stop", timeout_s=1.0, stops=both(1.0)),
    "human_in_loop": Link("/teleop_logi/human_in_loop", timeout_s=0.5, stops=both(0.5)),
    "tele_steer_req": Link("/teleop_logi/tele_steer_req", stops={STEERING: 0.5}),
    "tele_throt_req": Link("/teleop_logi/tele_throt_req", timeout_s=0.5, stops={ESC: 0.5}),
    "mode": Link("/teleop_logi/mode", stops={ESC: 0.5}),
    "scale_button": Link("/teleop_logi/scale_button"),
    "teleop_logi/state": Link("/teleop_logi/state"),
    "av_turnrad_req": Link("/av_turnrad_req", stops={STEERING: 0.5}, takes=PLANNER),
    "av_speed_req": Link("/av_speed_req", stops={ESC: 0.5}, takes=PLANNER),
    "control_cmd": Link(CONTROL, stops={ESC: 0.52}, takes=PLANNER),
    "value": Link("/generic/output/value", stops={ESC: 0.5}, takes=PLANNER),
    "converter's state": Link("/generic_value_converter/state"),
    "planner_interface's state": Link("/planner_interface/state"),
    "throttle_arb's state": Link("/throttle_arb/state"),
    "turn_arb's state": Link("/turn_arb/state", receiver="/throttle_arb", stops={ESC: 0.25}),
    "odom": Link("/odom", stops={ESC: 0.5}, takes=PLANNER),
    "steering command": Link(VECTOR, "/turn_arb", "/pca9685", 0.25, {STEERING: 0.25, ESC: 0.75}),
    "ESC command": Link(VECTOR, "/throttle_arb", "/pca9685", 0.25, {ESC: 0.25}),
    "output": Link("/servo/output", receiver="/throttle_arb", stops={ESC: 0.5}),
    "neutral": Link("/servo/neutral"),
}


# A stuck value of these is that of a person who holds on, or of a broken node: what remains, by the page.
OBEYED = ("joy", "phone/joy", "phone/e_stop", "e_stop", "human_in_loop", "steering command", "ESC command")


def stick(drive: Drive, link: Link) -> None:
    """Have a topic's last message come again and again, with new stamps, in place of those that are sent."""
    message = drive.graph.newest(link.topic)
    drive.graph.link(link.topic, link.sender, link.receiver, loses=lambda data: True)
    drive.graph.link(link.topic, "/stuck", link.receiver)

    def again():
        for stamped in (getattr(message, "header", None), message):
            if hasattr(stamped, "stamp"):
                stamped.stamp = drive.graph.ros_now
        return message
    drive.graph.repeat(link.topic, again, 50, "/stuck")


def link_kinds() -> Iterable[tuple[str, Kind]]:
    for name, link in LINKS.items():
        ways = link.topic, link.sender, link.receiver

        def set_link(drive, ways=ways, **how):
            drive.graph.link(*ways, **how)

        is_stop = link.timeout_s is not None
        timeout_s = link.timeout_s or 0.0
        # A human's evidence that comes back under a held deadman counts for nothing.
        undo = set_link if link.stops in (both(0.25), both(0.5)) else None
        yield f"{name} lost", Kind(partial(set_link, loses=lambda data: True), undo, timeout_s, stops=link.stops,
                                   takes=link.takes, modes=link.modes, centers=link.stops.keys() == {STEERING})
        yield f"{name} late", Kind(partial(set_link, delay_s=LATE_S), delay_s=LATE_S * is_stop, modes=link.modes)
        if name not in OBEYED:
            yield f"{name} stuck", Kind(lambda drive, link=link: stick(drive, link), modes=link.modes,
                                        actions=tuple(action for action in ACTIONS
                                                      if action != "pull" or name != "tele_throt_req"))
        yield f"{name} doubled", Kind(partial(set_link, copies=2), modes=link.modes)
        yield f"{name} with gaps", Kind(
            lambda drive, set_link=set_link: set_link(drive, loses=lambda data: drive.choose.random() < LOST),
            timeout_s=timeout_s, modes=link.modes)


# --- nodes ---

# The time-out of a person's stop; as of ``Kind``: stops, takes; whether the deadman must be released after a restart.
NODES = {
    "teleop_logi": (0.5, both(0.5), "", True),
    "turn_arb": (0.25, both(0.25), "", True),
    "throttle_arb": (0.25, {ESC: 0.25}, "", True),
    "pca9685": (0.25, both(0.25), "", False),
    "planner_interface": (0.0, {ESC: 0.52}, PLANNER, False),
    "generic_value_converter": (0.0, {ESC: 0.52}, PLANNER, False),
    "teensy_sensor_hub": (0.0, {ESC: 0.5}, PLANNER, False),
    "phone_drive": (0.25, both(0.25), "", True),
}
STALLS_S = (0.01, 0.1, 0.3, 0.6, 2.0)


def node_kinds() -> Iterable[tuple[str, Kind]]:
    for name, (timeout_s, stops, takes, rearms) in NODES.items():
        def node(drive, name=name):
            return drive.graph.nodes[f"/{name}"]

        modes = (PHONE,) if name == "phone_drive" else tuple(MODES)

        def start(drive, node=node):
            node(drive).start()

        lasts_s = math.inf if rearms else UNDO_S
        yield f"{name} killed", Kind(lambda drive, node=node: node(drive).kill(), None, timeout_s, 0.0, stops,
                                     takes=takes, modes=modes)
        yield f"{name} restarted", Kind(lambda drive, node=node: node(drive).kill(), start, timeout_s, 0.0, stops,
                                        lasts_s, takes, modes)
        yield f"{name} ended", Kind(lambda drive, node=node: node(drive).end(), start, timeout_s, 0.0, stops, lasts_s,
                                    takes, modes)
        for frozen, duration_s in itertools.product((False, True), STALLS_S):
            is_lost = duration_s > 0.52
            yield f"{name} {'frozen' if frozen else 'stalled'} {duration_s:g} s", Kind(
                lambda drive, node=node, frozen=frozen, duration_s=duration_s:
                node(drive).stall(duration_s, frozen=frozen), None, min(timeout_s, duration_s), 0.0,
                stops if is_lost else {}, math.inf if rearms else duration_s, takes, modes)


# --- devices, the clock, and other senders ---

def inject(fault, value):
    return lambda drive: drive.car.inject(fault, value)


def remove_board(drive):
    drive.chip = drive.car.board.bus.chips.pop(ADDRESS)
    drive.chip.power_up()
    drive.car.board.note()


def return_board(drive):
    drive.car.board.bus.chips[ADDRESS] = drive.chip


def hold_bus(drive):
    bus = drive.car.board.bus
    bus.held = True
    drive.graph.after(0.2, lambda: setattr(bus, "held", False))


def write_foreign(drive):
    drive.car.board.chip.write(6, [0, 0, 419 & 255, 419 >> 8])  # channel 0: full right
    drive.car.board.note()


def set_clock(hours):
    def make(drive):
        drive.graph.ros_ahead_ns += round(hours * 3600 * NS_PER_S)
    return make


def nacks(count):
    def make(drive):
        drive.car.board.bus.nacks_left = count
    return make


def also(topic, message, rate_hz=50):
    return lambda drive: drive.graph.repeat(topic, message, rate_hz, sender="/other")


def e_stop_once(drive):
    drive.graph.publish("/e_stop", Bool(True), "/other")


def pad(axes=6, buttons=11, **state):
    """Have the gamepad's messages be others than its sticks and buttons, or shorter, whatever its person does."""
    def make(drive):
        drive.pad_is, drive.pad_has = state, (axes, buttons)
        drive.hold(*drive.held)
    return make


def command(channel, duty):
    return Int32MultiArray(data=[duty if each == channel else -1 for each in range(16)])


NAN = math.nan
SERIAL = {"stops": {ESC: 0.5}, "takes": PLANNER}
OTHERS = {
    "one transfer fails": Kind(nacks(1)),
    # One, its repetition, and three attempts 0.1 s apart.
    "five transfers fail": Kind(nacks(5), timeout_s=0.4, holds=True),
    "brown-out of the board": Kind(lambda drive: drive.car.board.brown_out()),
    "board without power": Kind(remove_board, return_board),
    "bus held for 0.2 s": Kind(hold_bus, timeout_s=0.3, holds=True),
    "foreign write": Kind(write_foreign, timeout_s=0.5),
    "guard killed": Kind(lambda drive: drive.car.board.guards[-1].kill()),
    "guard frozen": Kind(lambda drive: drive.car.board.guards[-1].stall(1.0)),
    "clock an hour ahead": Kind(set_clock(1)), "clock an hour back": Kind(set_clock(-1)),
    "Teensy unplugged": Kind(inject("unplug", 1.0), lasts_s=1.0, **SERIAL),
    "Teensy silent": Kind(inject("silence", 2.0), **SERIAL),
    "Teensy restarted": Kind(inject("reboot", 0)), "serial flood": Kind(inject("flood", 1.0)),
    "serial noise": Kind(inject("scramble", 1.0), lasts_s=1.0, **SERIAL),
    "serial bit errors": Kind(inject("bit_errors", 1e-3)), "serial bytes lost": Kind(inject("cut", 50)),
    "Teensy out of step": Kind(inject("out_of_step", 0)),
    "a sonar missing": Kind(inject("sonar_missing", 1)), "a sonar stuck": Kind(inject("sonar_stuck", 1)),
    "gamepad of one axis": Kind(pad(axes=1), stops=both(0.0), modes=GAMEPAD),
    "gamepad of two buttons": Kind(pad(buttons=2), stops=both(0.0), modes=GAMEPAD),
    "gamepad's axis NaN": Kind(pad(steering=NAN, throttle=NAN), stops=both(0.0), modes=GAMEPAD),
    "phone out of range": Kind(lambda drive: setattr(drive.phone, "is_cut", True), timeout_s=0.53, stops=both(0.53),
                               modes=(PHONE,)),
    "phone frozen": Kind(lambda drive: setattr(drive.phone, "is_frozen", True), timeout_s=0.53, stops=both(0.53),
                         modes=(PHONE,)),
    "page loaded again": Kind(lambda drive: drive.phone.reload(), stops=both(0.0), delay_s=0.02, modes=(PHONE,)),
    "e-stop by another": Kind(e_stop_once, stops=both(0.0)),
    "a false deadman besides": Kind(also("/teleop_logi/human_in_loop", Bool(False))),
    "a false e-stop besides": Kind(also("/e_stop", Bool(False))),
    "another radius besides": Kind(also("/av_turnrad_req", Float32(-2.0))),
    "another speed besides": Kind(also("/av_speed_req", Float32(-1.0))),
    # Two who command the servo: it follows both after a release, too; the throttle ends (R9).
    "another steering command besides": Kind(also(VECTOR, command(STEERING, 6700)), actions=("nothing", "pull")),
    "wrong type of radius": Kind(also("/av_turnrad_req", Float64(2.0))),
    "wrong type of deadman": Kind(also("/teleop_logi/human_in_loop", Float32(1.0))),
    "wrong type of command": Kind(also(VECTOR, Float32(1.0))),
    "a vector of 15 besides": Kind(also(VECTOR, Int32MultiArray(data=[6700] * 15))),
    "an impossible duty besides": Kind(also(VECTOR, command(ESC, 70000))),
    "radius NaN": Kind(also("/av_turnrad_req", Float32(NAN))), "speed NaN": Kind(also("/av_speed_req", Float32(NAN))),
    "value NaN": Kind(also("/generic/output/value", Float64Stamped(data=NAN))),
    "acceleration NaN": Kind(also(CONTROL, control(NAN))), "odometry NaN": Kind(also("/odom", odometry(NAN))),
    "steering NaN": Kind(also("/teleop_logi/tele_steer_req", Float32(NAN)), centers=True),
    "throttle NaN": Kind(also("/teleop_logi/tele_throt_req", Float32(NAN))),
}
KINDS: dict[str, Kind] = {**dict(link_kinds()), **dict(node_kinds()), **OTHERS}
# What remains, by the page's number: against these there is nothing, and a person's release isn't obeyed.
RESIDUAL = {
    "R1": Kind(pad(manual=True, steering=0.5, throttle=0.6)),
    "R2": Kind(lambda drive: [KINDS[name].make(drive) for name in ("guard killed", "pca9685 killed")]),
    "R6": Kind(also("/teleop_logi/human_in_loop", Bool(True), 200)),
    "R9": Kind(also(VECTOR, command(ESC, 6000), 200)),
}


def together(one: Kind, other: Kind) -> Kind:
    """Return two faults at once: of a person's stop each has its own delay."""
    modes = tuple(mode for mode in one.modes if mode in other.modes)
    actions = tuple(action for action in one.actions if action in other.actions and action != "nothing")

    def make(drive):
        one.make(drive)
        other.make(drive)
    # A time-out may also lengthen the throttle without steering; and there are two ticks.
    delay_s = one.timeout_s + other.timeout_s + one.delay_s + other.delay_s + TICK_S
    return Kind(make, delay_s=delay_s, modes=modes, actions=actions, centers=one.centers or other.centers,
                holds=one.holds or other.holds)


# Of each sort of fault one, for pairs.
PAIRED = [name for name in KINDS if name.endswith((" lost", " killed", " frozen 0.6 s", " stalled 0.3 s"))] + [
    "odom stuck", "odom late", "human_in_loop late", "ESC command late", "output late", "five transfers fail",
    "brown-out of the board", "foreign write", "guard frozen", "clock an hour back", "Teensy restarted", "serial noise"]
PAIRS = {f"{one}, {other}": kind for one, other in itertools.combinations(PAIRED, 2)
         for kind in [together(KINDS[one], KINDS[other])]
         if kind.modes and not (one.startswith("pca9685") and other.startswith("guard"))}  # R2


# --- a drive ---

class Case(NamedTuple):
    kind: str
    moment: int
    mode: str
    esc: str
    action: str


class Drive:
    """A whole car that drives to the left.

    Attributes:
        pad_is, pad_has: what the gamepad's messages have in place of its state; how many axes and buttons.
    """

    def __init__(self, mode: str, esc: str):
        self.mode, self.choose = MODES[mode], random.Random(f"{mode} {esc}")
        settings = {"profile": esc, "profile_measured": esc != "unverified"}
        nodes = {"throttle_arb": {"esc": settings}, "pca9685": {"esc": {**config("throttle.yaml"), "esc": settings},
                                                                "guard": True},
                 "teleop": {"third_button": THIRD, "third_mode": self.mode.third_mode}}
        self.car = Car()
        self.car.graph.record(*(link.topic for link in LINKS.values()))
        self.car.whole("speed", nodes, esc_kind=ESCS[esc], obstacles=False, collisions=False)
        self.graph = self.car.graph
        self.graph.hold("/av_turnrad_req", Float32(2.0), 20, sender="/planner")
        self.graph.hold("/av_speed_req", Float32(2.0), 20, sender="/planner")
        self.pad_is: dict = {}
        self.pad_has = 6, 11
        self.phone: Phone | None = None
        if self.mode.deadman == PHONE:
            network = Network(self.graph)
            network.add_node()
        self.graph.run(2.5)
        if self.mode.deadman == PHONE:
            self.phone = Phone(network)
            self.graph.run(0.3)
            self.phone.hold("")
            self.phone.evidence("drive")
            self.graph.run(0.3)
        self.hold(True, 0.0)
        self.graph.run(0.1)
        self.hold(True, 0.6 if self.mode.drives == HUMAN else 0.0)
        self.graph.run_until(lambda: self.car.speed_mps > 1.5 and self.car.board.counts[STEERING] < CENTER
                             and self.car.board.counts[ESC] > ESC_NEUTRAL)
        self.graph.run_to(-(-self.graph.now_ns // (100 * MS)) * 100 * MS)
        self.begin_ns = self.graph.now_ns
        self.car.board.changes[:] = self.car.board.changes[-1:]
        self.graph.recorded.pop("/diagnostics")

    def hold(self, is_held: bool, throttle: float) -> None:
        """Have the person hold the deadman or not, with the sticks where the mode needs them."""
        self.held = is_held, throttle
        steering = 0.6 if is_held and self.mode.steers == HUMAN else 0.0
        if self.phone is not None:
            self.phone.hold("manual" if is_held else "", steering, throttle)
        else:
            self.car.pad(**{self.mode.deadman: is_held, "steering": steering, "throttle": throttle, **self.pad_is})
            joy, (axes, buttons) = self.car.joy_now, self.pad_has
            joy.axes, joy.buttons = joy.axes[:axes], joy.buttons[:buttons]
            self.graph.publish("/joy", joy, "/joy_node")  # a gamepad's driver publishes changes at once

    def act(self, action: str) -> None:
        if action == "release":
            self.hold(False, 0.0)
        elif action == "pull":
            self.hold(True, -1.0)
        elif self.phone is not None:
            self.phone.send(type="e_stop")
        else:
            self.graph.hold("/e_stop", Bool(True), 10)

    def run_to_moment(self, moment: int) -> None:
        self.graph.run_to(self.begin_ns + moment * 5 * MS + moment % 3 - 1 + (moment == 0))

    def rest_after(self, pin: int, since_ns: int, until_ns: int) -> float:
        """Return how long after a time a pin has come to rest, until another time; inf = it has not."""
        changes = self.car.board.changes
        times = [*(at_ns for at_ns, _ in changes[1:]), math.inf]  # until when each holds
        moving = [until for until, (at_ns, counts) in zip(times, changes)
                  if at_ns < until_ns and until > since_ns and not is_at_rest(pin, counts)]
        return max(0.0, moving[-1] - since_ns) / NS_PER_S if moving else 0.0


def is_at_rest(pin: int, counts: tuple[int, ...]) -> bool:
    """Return whether a pin gives its neutral, or nothing; the ESC's may brake."""
    return counts[pin] in (0, CENTER) if pin == STEERING else counts[pin] <= ESC_NEUTRAL


class Judged(NamedTuple):
    """What a run showed.

    Attributes:
        violations: of goals.
        figures: the longest reaction, s, and what of it is beyond time-out and delays; the longest time of throttle
            without steering, s, where this is a fault; the highest speed backward, m/s.
    """

    violations: list[str]
    figures: tuple[float, float, float, float]


def run(drive: Drive, case: Case, kind: Kind, after_s: float) -> Judged:
    """Make the fault, have the person act some time after it, and judge what servo, ESC and car did.

    Args:
        after_s: when the person acts; below 0: before the fault, which falls into the stop.
    """
    graph = drive.graph
    if after_s < 0 and case.action != "nothing":
        drive.act(case.action)
        graph.run(-after_s)
    fault_ns = graph.now_ns
    way_s = 0.02 * (drive.phone is not None)  # the phones' network
    kind.make(drive)
    stops = {pin: timeout_s for pin, timeout_s in kind.stops.items()
             if kind.takes in ("", (drive.mode.steers, drive.mode.drives)[pin])}
    act_ns = fault_ns + round(after_s * NS_PER_S)
    bound_s = kind.timeout_s + kind.delay_s + way_s
    end_s = max([after_s + bound_s if case.action != "nothing" else 0.0,
                 *(timeout_s + kind.delay_s for timeout_s in stops.values()),
                 UNDO_S + 0.1 if kind.undo and stops else 0.0]) + TICK_S + SETTLE_S
    if kind.undo is not None:
        graph.after(UNDO_S, lambda: kind.undo(drive))
    if after_s >= 0 and case.action != "nothing":
        graph.after(after_s, lambda: drive.act(case.action))
    graph.run(end_s)
    end_ns = graph.now_ns
    found, reactions, excesses = [], [0.0], [-math.inf]

    def judge(pin, what, since_ns, until_ns, bound_s):
        reactions.append(drive.rest_after(pin, since_ns, until_ns))
        excesses.append(reactions[-1] - bound_s)
        if excesses[-1] > TICK_S + 1e-9:
            found.append(f"{what}: {('servo', 'ESC')[pin]} at rest {excesses[-1]:.4f} s after {bound_s:.2f} s")

    for pin, timeout_s in stops.items():
        judge(pin, "G6", fault_ns, min(end_ns, fault_ns + kind.lasts_s * NS_PER_S), timeout_s + kind.delay_s)
    for pin in {"nothing": (), "pull": (ESC,)}.get(case.action, BOTH):
        judge(pin, "G4" if case.action == "pull" else "G1", max(act_ns, fault_ns), end_ns, bound_s)
    slowest_mps = min(each.twist.twist.linear.x for each in graph.messages("/car_sim/truth", drive.begin_ns))
    if slowest_mps < -NOISE_MPS and not (kind.holds and case.esc not in ("brake_then_reverse", "forward_only")):
        found.append(f"G2: it drove backward at {slowest_mps:.2f} m/s")
    alone_s = 0.0 if kind.centers else longest_alone_s(drive.car.board.changes, end_ns)
    if alone_s > TOGETHER_S + kind.delay_s:
        found.append(f"G3: throttle without steering for {alone_s:.2f} s")
    figures = max(reactions), max(excesses), alone_s, max(0.0, -slowest_mps)
    return Judged([f"{each}: {case}" for each in found], figures)


def longest_alone_s(changes, end_ns) -> float:
    """Return for how long the ESC was pushed while the servo was not turned to the left."""
    longest_ns, since_ns = 0, None
    for (at_ns, counts), until_ns in zip(changes, [*(at_ns for at_ns, _ in changes[1:]), end_ns]):
        if counts[ESC] > ESC_NEUTRAL and not 0 < counts[STEERING] < CENTER:
            since_ns = at_ns if since_ns is None else since_ns
            longest_ns = max(longest_ns, until_ns - since_ns)
        else:
            since_ns = None
    return longest_ns / NS_PER_S


# --- cases ---

def cases(kinds: dict[str, Kind], draws: int, seed: int) -> list[Case]:
    """Return cases in which each kind is at each moment ``draws`` times, and with each mode, ESC and action, and each
    two of those are together at each moment: of some random ones always that with most pairs that are new.
    """
    choose, known = random.Random(seed), set()
    found = []
    for _, moment, (name, kind) in itertools.product(range(draws), range(MOMENTS), kinds.items()):
        drawn = [Case(name, moment, choose.choice(kind.modes), choose.choice(list(ESCS)),
                      choose.choice(kind.actions))
                 for _ in range(6)]
        best = max(drawn, key=lambda case: len(set(itertools.combinations(enumerate(case), 2)) - known))
        known.update(itertools.combinations(enumerate(best), 2))
        found.append(best)
    return found
