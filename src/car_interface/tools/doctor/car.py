"""Examines the running car: its nodes, their parameters, who drives, the gamepad, and their reports."""
from __future__ import annotations

import math
import time
from typing import Any, Collection, Iterable, NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.black_box_folder import newest
from car_interface.common.publishers import REPORT as COMMAND_TOPICS
from car_interface.common.sources import source_name
from car_interface.teleop.gamepad import GamepadConfig, is_d_mode_cross, missing_index, remedy
from car_interface.teleop.handover import PHONE_PREFIX
from car_interface.throttle.battery import REPORT as BATTERY
from car_interface.tools.doctor.findings import BAD, BY_SILENCE, OK, WARN, Finding, all_of, first

# The nodes of every car, and what is missing without each.
NODE_ROLES = {
    "turn_arb": "nobody steers",
    "pca9685": "no servo moves",
    "teensy_sensor_hub": "no wheel and no sonar reports",
    "generic_value_converter": "no acceleration becomes throttle",
    "teleop_logi": "no gamepad, no deadman",
}
MORE = "More about it: rostopic echo /diagnostics"
# The process that some of them may share, which the master then knows by this name alone.
ONE_PROCESS = "car_nodes"
SIMULATOR = "car_sim"
MISSED = 2  # messages in a row that may be lost before the deadman is released, at least
AUTOREPEAT = "Set its driver's autorepeat_rate to 20, as launching with gamepad:=true does: {joy} must come at 20 Hz"
D_MODE = ", as a Logitech gamepad has in D mode: axes 4 and 5 are its cross then, not a stick"
LAUNCH_IT = ("Launch the car with gamepad:=true, which starts its driver, or with phone:=true. With the virtual car: "
             "rosrun car_interface keyboard_drive")
LET_GO = "Let go of both deadman buttons once, then hold one"

# What a node does, by the ROS graph and by its own answer. A node that ended in order is absent, whatever else the
# master remembers of it; one that was killed stays in the graph, but nothing listens at its address.
ABSENT, RUNNING, KILLED, SILENT = "absent", "running", "killed", "silent"


class Node(NamedTuple):
    """A node that may run."""

    name: str  # without its namespace
    path: str  # with it
    state: str  # ABSENT, RUNNING, KILLED or SILENT
    process: str  # by which name the master knows it, with the namespace: its own, or that of ONE_PROCESS

    @property
    def runs(self) -> bool:
        """Return whether it's there and answers."""
        return self.state == RUNNING


def restart_remedy(process: str) -> str:
    """Return how to start a node again that hangs."""
    return f"Stop the car, then rosnode kill {process}: roslaunch starts it again"


def find_cars(names: Iterable[str]) -> list[str]:
    """Return the namespaces in which nodes of a car are, from the names of all nodes of the ROS graph; sorted."""
    spaces = (name.rpartition("/") for name in names)
    return sorted({space or "/" for space, _, name in spaces if name in NODE_ROLES or name == ONE_PROCESS})


def check_several(namespaces: Sequence[str]) -> list[Finding]:
    """Return the finding that there are several cars, none of which was asked for."""
    return [Finding(WARN, "nodes", f"there are {len(namespaces)} cars, in {' and '.join(namespaces)}: none was looked "
                                   "at", f"Look at each: rosrun car_interface doctor --ns {namespaces[0]}")]


def check_nodes(nodes: Collection[Node], namespace: str, others: Sequence[str] = ()) -> list[Finding]:
    """Return one finding for those that run, one for each process that doesn't, and one for those that are missing.

    The nodes are those of the car in ``namespace``; ``others`` are the namespaces of other cars.
    """
    if all(node.state == ABSENT for node in nodes):
        elsewhere = f"; there is one in {' and '.join(others)}" if others else ""
        return [Finding(OK, "nodes", f"none of this package's runs in {namespace}{elsewhere}")]
    running = [node for node in nodes if node.runs]
    silent, killed = (list(dict.fromkeys(node.process for node in nodes if node.state == state))  # each process once
                      for state in (SILENT, KILLED))
    shared = [node for node in running if node.process != node.path]
    together = f"; {', '.join(node.name for node in shared)} in one process, {shared[0].process}" if shared else ""
    verb = "runs" if len(running) == 1 else "run"
    is_virtual = any(node.name == SIMULATOR and node.state != ABSENT for node in nodes)
    launch = (f"roslaunch car_interface {'demo' if is_virtual else 'car'}.launch"
              + ("" if namespace == "/" else f" ns:={namespace}"))
    missing = [f"{node.name} ({NODE_ROLES[node.name]})" for node in nodes
               if node.state == ABSENT and node.name in NODE_ROLES]
    return all_of(
        "nodes",
        (running, OK, f"{', '.join(node.name for node in running)} {verb} in {namespace}{together}"),
        *((True, BAD,
           f"{process} is registered, but doesn't answer: it hangs, or its ROS_IP can't be reached from here",
           ("If it hangs: end its process, or start the launch file again. If it's on another computer: set ROS_IP "
            "there to an address that can be reached from here"), BY_SILENCE) for process in silent),
        (killed, BAD,
         (f"{', '.join(killed)}: killed or crashed; the master still lists {'it' if len(killed) == 1 else 'them'}, but "
          "nothing answers there"),
         f"Start the launch file again: {launch}. To clear the list: rosnode cleanup"),
        (missing, WARN, f"not running in {namespace}: {', '.join(missing)}",
         f"Those that this car needs: {launch}, or each by its own file"))


def check_steering(states: Sequence[Any], node: Node) -> list[Finding]:
    """Return who drives and why, by each SteeringState that came; a single one may be latched by a node that ended."""
    if len(states) < 2:
        return [Finding(BAD, "steering", f"{node.path} says nothing of who drives; it hangs",
                        restart_remedy(node.process), by_silence=True)]
    state = states[-1]
    return [Finding(OK, "steering", f"{source_name(state.source)}: {state.reason}; duty {state.duty}")]


class Report(NamedTuple):
    """One entry of /diagnostics."""

    name: str  # the node's, and what it is about: ``car1/turn_arb: steering``
    level: int
    message: str
    remedy: str = ""  # its value of this name

    @property
    def node(self) -> str:
        """Return the name of the node, without the first slash."""
        return self.name.partition(": ")[0]

    @property
    def about(self) -> str:
        """Return what of the node it is about."""
        return self.name.partition(": ")[2]


def check_diagnostics(reports: Sequence[Report], reporting: Sequence[str],
                      told: Collection[str] = ()) -> list[Finding]:
    """Return one finding for all that is well, and one for each that is not.

    Those about command topics and the battery are left out, which have findings of their own.

    Args:
        reporting: the paths of the running nodes, which should each report.
        told: what the reports are about whose faults another finding tells.
    """
    ours = [report for report in reports if report.about not in (COMMAND_TOPICS, BATTERY)]
    good, nodes = [report.name for report in ours if report.level == OK], {report.node for report in reports}
    return all_of(
        "reports",
        (good, OK, ", ".join(good)),
        *((report.level != OK and report.about not in told, min(report.level, BAD),
           f"{report.name}: {report.message}", report.remedy or MORE) for report in ours),
        *((path.strip("/") not in nodes, BAD, f"{path} runs, but doesn't report on /diagnostics",
           f"See whether it hangs: rosnode ping {path}", BY_SILENCE) for path in reporting))


def check_battery(reports: Sequence[Report]) -> list[Finding]:
    """Return the battery's voltage, or what is wrong with it, as throttle_arb reports it."""
    return [Finding(min(report.level, BAD), "battery", report.message, report.remedy)
            for report in reports if report.about == BATTERY]


def check_command_topics(reports: Sequence[Report]) -> list[Finding]:
    """Return what is wrong with the publishers of the topics that the nodes obey, each fault once."""
    ours = [report for report in reports if report.about == COMMAND_TOPICS]
    nodes: dict[tuple, list[str]] = {}
    for report in ours:
        if report.level != OK:
            nodes.setdefault((report.message, report.remedy), []).append(report.node)
    if ours and not nodes:
        return [Finding(OK, "topics", "each that is obeyed has the publishers that it should have")]
    return [Finding(BAD, "topics", f"{message} (reported by {', '.join(names)})", remedy or MORE)
            for (message, remedy), names in nodes.items()]


def reports_of(reports: Sequence[Report], namespace: str) -> list[Report]:
    """Return the reports of one car's nodes, without those of other cars."""
    return [report for report in reports if report.node.rpartition("/")[0] == namespace.strip("/")]


def check_black_box(folder: str) -> list[Finding]:
    """Return what the newest recording in the black box's folder is of, if there is one."""
    recording = newest(folder)
    return [Finding(OK, "black box", "the last stop that nobody asked for: "
                                     f"{recording.describe(time.time())}: {recording.command}")] if recording else []


# --- the gamepad ---

class GamepadFacts(NamedTuple):
    """What is known of the gamepad, and of the messages that came on its topic while the doctor listened."""

    node: str  # teleop_logi's path
    topic: str  # that it subscribes to
    publishers: Sequence[str]  # the nodes that publish on it
    # What teleop_logi takes its axes and buttons for; ``None`` = its parameters are bad, as another finding says, or
    # the gamepad is in no gamepads.yaml.
    config: GamepadConfig | None
    messages: int
    period_s: float  # the mean time between them; after a single one, the time since then; inf: none came
    axes: int  # of the newest one
    buttons: int
    odd: dict  # the newest values that aren't finite, by index of the axis
    state: Any  # teleop_logi's newest TeleopState; an empty one = it published nothing
    driver: Report | None  # what gamepad_joy reports, where it has no gamepad


def check_gamepad(gamepad: GamepadFacts) -> list[Finding]:
    """Return one finding: the first thing that keeps a deadman from being held, or that all is well."""
    topic, driver, cause, reason = gamepad.topic, gamepad.driver, gamepad.state.cause, gamepad.state.reason
    is_silent, is_lost = not gamepad.messages, cause in causes.LOSSES
    is_off_rest = causes.NOT_AT_REST in (gamepad.state.steering_stick, gamepad.state.throttle_stick)
    by_phone = is_silent and reason.startswith(PHONE_PREFIX)
    return first(
        "gamepad",
        (by_phone and is_lost, WARN, f"there is none; {reason}",
         "Lift the thumbs from the phone's page, then touch it again"),
        (by_phone, OK, f"there is none; {reason}"),
        (is_silent and not gamepad.publishers, WARN,
         f"no node publishes {topic}, so that no deadman can be held" + (f" ({reason})" if reason else ""), LAUNCH_IT),
        (is_silent and driver, WARN, driver and driver.message, driver and driver.remedy),
        (is_silent, WARN, f"{', '.join(gamepad.publishers)} publishes {topic}, but nothing came",
         f"{remedy(causes.JOY_NEVER_RECEIVED, topic)}. {AUTOREPEAT.format(joy=topic)}, also while nothing moves"),
        (cause == causes.JOY_NEVER_RECEIVED, BAD, f"{topic} comes here, but {gamepad.node} says: {reason}",
         f"See whether they reach each other: rosnode info {gamepad.node}; ROS_IP; then start it again"),
        (cause == causes.JOY_UNMAPPED, BAD, reason, remedy(cause, topic)),
        *(_faults(gamepad) if gamepad.config else ()),
        (is_lost, WARN, reason, remedy(cause, topic) or LET_GO),
        (is_off_rest, WARN, reason, remedy(causes.NOT_AT_REST, topic)),
        (True, OK, f"{topic}: {gamepad.axes} axes, {gamepad.buttons} buttons, {_rate_text(gamepad)}"
         + (f"; {reason}" if reason else "")))


def _faults(gamepad):
    """Return the cases of what can be wrong with the messages."""
    config, topic, shape = gamepad.config, gamepad.topic, (gamepad.axes, gamepad.buttons)
    missing, timeout_s = missing_index(config, *shape), config.joy_timeout_s or math.inf
    sticks = {name: getattr(config, name) for name in ("steer_axis", "throttle_axis")}
    is_d_mode = any(is_d_mode_cross(index, *shape) for index in sticks.values())
    comes, autorepeat = f"{topic} comes {_rate_text(gamepad)}", AUTOREPEAT.format(joy=topic)
    return [
        (missing, BAD, missing and missing[1], remedy(causes.JOY_INCOMPLETE, topic)),
        *((index in gamepad.odd, BAD, f"the gamepad's {name} {index} is {gamepad.odd.get(index)}, no number to act on",
           remedy(causes.JOY_NOT_FINITE, topic)) for name, index in sticks.items()),
        (gamepad.period_s > timeout_s, BAD,
         f"{comes}, too seldom for a joy_timeout of {timeout_s:g} s: the deadman is released again and again",
         autorepeat),
        (gamepad.period_s * MISSED > timeout_s, WARN,
         f"{comes}: with a joy_timeout of {timeout_s:g} s one message that is late releases the deadman", autorepeat),
        (is_d_mode, WARN, f"{gamepad.axes} axes and {gamepad.buttons} buttons{D_MODE}",
         remedy(causes.JOY_INCOMPLETE, topic))]


def _rate_text(gamepad):
    return (f"once in {gamepad.period_s:.1f} s" if gamepad.messages < 2 else
            f"{1 / gamepad.period_s:.1f} times a second")
