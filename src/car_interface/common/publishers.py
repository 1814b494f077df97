"""Finds faults in who publishes on a topic that a node obeys: a wrong message type, a second publisher.

Pure: the known publishers in, faults out. ROS itself reports nothing: a node with another message type, or on a host
whose name can't be looked up, is ignored, and two nodes that publish on one topic undo each other's commands.
"""
from __future__ import annotations

from typing import Callable, Mapping, NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.sources import AUTOWARE, CMD_VEL, DRIVE, SPEED
from car_interface.common.units import NS_PER_S

# ``rostopic pub -1`` registers, sends once and goes within 3 s: such a publisher is reported but not logged.
LASTING_NS = 5 * NS_PER_S
PASSING = (causes.SECOND_PUBLISHER, causes.PLANNER_UNHEARD)
LOG_PERIOD_NS = 10 * NS_PER_S
REPORT = "command topics"  # on /diagnostics
ANY = "*"
OR = " or "
# By what a planner is known, for each value of the launch argument ``planner``. Accelerations alone are heard without
# it; Autoware sends a gear beside them.
PLANNER_TOPICS = {DRIVE: "drive", CMD_VEL: "cmd_vel", AUTOWARE: "control/command/gear_cmd", SPEED: "av_speed_req"}
BY_HAND = ("rostopic_", "rqt_gui_py_node")  # the names of tools' nodes begin so


class Publisher(NamedTuple):
    """A node that publishes on a topic."""

    node: str  # with its namespace
    machine: str  # the host that it runs on, as its address names it
    type: str  # such as std_msgs/Bool; empty = it can't be asked, as its machine's name can't be looked up

    def __str__(self):
        return f"{self.node} on {self.machine}"


class CommandTopic(NamedTuple):
    """A topic that a node obeys."""

    name: str  # resolved, after remapping
    type: str  # that the node takes; several with " or " between them, or ANY
    publishers: Sequence[Publisher]  # that were found
    is_shared: bool = False  # whether several may publish on it


class Fault(NamedTuple):
    """A fault of the publishers of a topic."""

    cause: str  # one of ``causes``
    subject: str  # the topic, or a part of what it carries
    reason: str  # with node, machine and type
    remedy: str

    @property
    def text(self) -> str:
        """Return reason and remedy, for a log line or a report."""
        return f"{self.reason}. {self.remedy}"


def find_faults(topic: CommandTopic) -> list[Fault]:
    """Return what is wrong with the publishers of a topic; nothing when there are none."""
    lost = sorted(publisher for publisher in topic.publishers if not publisher.type)
    sending = sorted(publisher for publisher in topic.publishers if publisher.type)
    right = [publisher for publisher in sending if topic.type == ANY or publisher.type in topic.type.split(OR)]
    wrong = [publisher for publisher in sending if publisher not in right]
    found = [Fault(causes.WRONG_TYPE, topic.name,
                   f"{publisher} publishes {publisher.type} on {topic.name}, which takes {topic.type}: none of its "
                   "messages is received", f"Have {publisher.node} publish {topic.type}, or publish on another topic")
             for publisher in wrong]
    found += [Fault(causes.UNKNOWN_HOST, topic.name,
                    f"{publisher.node} publishes on {topic.name} from a computer that it calls {publisher.machine}, "
                    "which can't be looked up here: none of its messages is received",
                    f"Where {publisher.node} runs, set ROS_IP to that computer's address, and start it again; if it "
                    "has ended: rosnode cleanup")
              for publisher in lost]
    if len(right) > 1 and not topic.is_shared:
        found.append(second_publisher(topic.name, f"{len(right)} nodes publish on {topic.name}", right))
    return found


def second_publisher(subject: str, what: str, publishers: Sequence[Publisher]) -> Fault:
    """Return the fault of several nodes that command one thing; its reason begins with ``what``."""
    by_hand = [publisher.node for publisher in publishers if publisher.node.rpartition("/")[2].startswith(BY_HAND)]
    example = f"rosnode kill {by_hand[0]}" if by_hand else "rosnode kill ends a node"
    return Fault(causes.SECOND_PUBLISHER, subject,
                 f"{what}, {' and '.join(map(str, publishers))}: the newest message counts, so that each undoes what "
                 "the other commands", f"End all but the one that shall command: {example}")


def find_unheard_planner(listed: Mapping[str, Sequence[str]], resolve: Callable[[str], str]) -> list[Fault]:
    """Return the fault of a planner whose messages nobody takes, as ``planner:=`` was forgotten; or nothing.

    A planner that sends turn_arb's own requests needs no planner_interface, but for its speeds.

    Args:
        listed: the names of the nodes that publish, by topic.
        resolve: returns a topic's full name.
    """
    def senders(name):
        return listed.get(resolve(name), ())

    if senders("planner_interface/state"):
        return []
    steers = senders("av_turnrad_req") or senders("av_steer_req")
    for planner, name in PLANNER_TOPICS.items():
        if senders(name) and (planner == SPEED or not steers):
            return [Fault(causes.PLANNER_UNHEARD, resolve(name),
                          f"{' and '.join(senders(name))} publishes {resolve(name)}, and nobody hears it: "
                          "planner_interface doesn't run", f"Start the launch file with planner:={planner}")]
    return []


class FaultLog:
    """Keeps how long faults have lasted, and which are due for a log line."""

    def __init__(self):
        self._since_ns: dict[tuple, int] = {}  # by cause and subject
        self._next_log_ns: dict[tuple, int] = {}

    def update(self, faults: Sequence[Fault], now_ns: int) -> list[Fault]:
        """Take the present faults; return those to log: lasting ones, at once and every 10 s."""
        keys = [(fault.cause, fault.subject) for fault in faults]
        self._since_ns = {key: self._since_ns.get(key, now_ns) for key in keys}
        waiting = {key: at_ns for key, at_ns in self._next_log_ns.items() if at_ns > now_ns}
        due = {key: fault for key, fault in zip(keys, faults) if self.is_lasting(fault, now_ns) and key not in waiting}
        self._next_log_ns = {**waiting, **dict.fromkeys(due, now_ns + LOG_PERIOD_NS)}
        return list(due.values())

    def is_lasting(self, fault: Fault, now_ns: int) -> bool:
        """Return whether a fault is there to stay; a second publisher may be gone, and a node there, at once."""
        since_ns = self._since_ns.get((fault.cause, fault.subject), now_ns)
        return fault.cause not in PASSING or now_ns - since_ns >= LASTING_NS
