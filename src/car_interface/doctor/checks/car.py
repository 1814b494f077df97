"""The running car: its nodes, their parameters, who drives, and their reports."""
from __future__ import annotations

from typing import NamedTuple, Sequence

from car_interface.doctor.checks.findings import BAD, OK, WARN, Finding

# The nodes of every car, and what is missing without each.
NODE_ROLES = {
    "turn_arb": "nobody steers",
    "pca9685": "no servo moves",
    "teensy_sensor_hub": "no wheel and no sonar reports",
    "generic_value_converter": "no acceleration becomes throttle",
    "teleop_logi": "no gamepad, no deadman",
}


class Node(NamedTuple):
    """A node that the master may know.

    Attributes:
        name: without its namespace.
        path: with it.
        registered: whether the master knows it.
        answers: whether it answered when it was asked directly.
    """

    name: str
    path: str
    registered: bool
    answers: bool


def check_nodes(nodes: Sequence[Node], namespace: str) -> list[Finding]:
    """One finding for those that run, one for each that doesn't answer, and one for those that are missing."""
    living = [node for node in nodes if node.answers]
    if not any(node.registered for node in nodes):
        return [Finding(OK, "nodes", f"none of this package's runs in {namespace}")]
    found = [Finding(OK, "nodes", f"{', '.join(node.name for node in living)} run in {namespace}")] if living else []
    for node in nodes:
        if node.registered and not node.answers:
            found.append(Finding(BAD, "nodes", f"{node.path} is registered, but doesn't answer: it hangs, was killed, "
                                               "or its ROS_IP can't be reached from here",
                                 "Start the launch file again; if it was killed: rosnode cleanup"))
    missing = [f"{node.name} ({NODE_ROLES[node.name]})" for node in nodes
               if not node.registered and node.name in NODE_ROLES]
    if missing:
        found.append(Finding(WARN, "nodes", f"not running in {namespace}: {', '.join(missing)}",
                             "Those that this car needs: roslaunch car_interface car.launch, or each by its own file"))
    return found


class Steering(NamedTuple):
    """What turn_arb's state says."""

    source: str
    reason: str
    duty: int
    repeats: bool  # whether it came more than once: a latched message outlives the node that sent it


def check_steering(steering: Steering | None, node: str) -> list[Finding]:
    """Who drives and why; ``None`` = the node runs, but says nothing."""
    if steering is None or not steering.repeats:
        return [Finding(BAD, "steering", f"{node} says nothing of who drives; it hangs", f"rosnode kill {node}: "
                                                                                         "roslaunch starts it again")]
    return [Finding(OK, "steering", f"{steering.source}: {steering.reason}; duty {steering.duty}")]


class Report(NamedTuple):
    """One entry of /diagnostics."""

    name: str
    level: int
    message: str


def check_diagnostics(reports: Sequence[Report], namespace: str, reporting: Sequence[str], reported: Sequence[str] = ()
                      ) -> list[Finding]:
    """One finding for all that is well, and one for each that is not.

    Args:
        reports: the newest of each name.
        namespace: the car's; other cars' reports are left out.
        reporting: the paths of the running nodes, which should each report.
        reported: the names of reports that another finding covers.
    """
    prefix = namespace.strip("/") + "/" if namespace.strip("/") else ""
    ours = [report for report in reports if report.name.startswith(prefix)
            and "/" not in report.name.partition(":")[0][len(prefix):]]
    missing = [path for path in reporting if not any(_is_of(report, path) for report in ours)]
    bad = [report for report in ours if report.level != OK and report.name not in reported]
    found = [Finding(OK, "reports", ", ".join(report.name for report in ours if report.level == OK))]
    found = found if any(report.level == OK for report in ours) else []
    for report in bad:
        found.append(Finding(min(report.level, BAD), "reports", f"{report.name}: {report.message}",
                             "More about it: rostopic echo /diagnostics"))
    for path in missing:
        found.append(Finding(BAD, "reports", f"{path} runs, but doesn't report on /diagnostics",
                             f"See whether it hangs: rosnode ping {path}"))
    return found


def _is_of(report, path):
    return report.name.startswith(f"{path.strip('/')}: ")


class Reading(NamedTuple):
    """How a node took the parameters that are on the server for it.

    Attributes:
        path: the node's name, with its namespace.
        fault: why it refused them; empty when it took them.
        runs: whether the node runs, with the parameters that it found when it started.
    """

    path: str
    fault: str
    runs: bool


def check_parameters(readings: Sequence[Reading]) -> list[Finding]:
    """One finding for all nodes that take their parameters, and one for each that doesn't."""
    if not readings:
        return [Finding(OK, "parameters", "none on the server; launch files bring them")]
    good = [reading.path for reading in readings if not reading.fault]
    found = [Finding(OK, "parameters", f"those of {', '.join(good)} are good")] if good else []
    for reading in readings:
        if reading.fault:
            later = ": it will not start again with these" if reading.runs else ": it can't start with these"
            found.append(Finding(BAD, "parameters", f"{reading.path}{later}: {reading.fault}",
                                 "Correct the YAML file or the launch file, and start again"))
    return found
