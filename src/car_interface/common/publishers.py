"""Who publishes on a topic that a node obeys, and whether they may: the right message type, and nobody else.

Pure: what is known of the publishers in, faults out. ROS itself says nothing: a node with another message type, or on a
host whose name can't be looked up, is ignored, and of two nodes that publish on one topic each message counts, so that
they undo each other's.
"""
from __future__ import annotations

from typing import NamedTuple, Sequence

from car_interface.common import causes
from car_interface.common.units import NS_PER_S

# A publisher that comes, sends once and goes, as ``rostopic pub -1`` does in 3 s, is shown but not logged.
LASTING_NS = 5 * NS_PER_S
LOG_PERIOD_NS = 10 * NS_PER_S
REPORT = "command topics"  # on /diagnostics
ANY = "*"
OR = " or "
BY_HAND = ("rostopic_", "rqt_gui_py_node")  # how tools call their nodes


class Publisher(NamedTuple):
    """A node that publishes on a topic.

    Attributes:
        node: its name, with its namespace.
        machine: the host that it runs on, as it tells others to call it.
        type: the type of its messages, such as ``std_msgs/Bool``; empty = it can't be asked, as its machine's name
            can't be looked up.
    """

    node: str
    machine: str
    type: str

    def __str__(self):
        return f"{self.node} on {self.machine}"


class CommandTopic(NamedTuple):
    """A topic that a node obeys.

    Attributes:
        name: resolved, after remapping.
        type: the type of the messages that the node takes; several with " or " between them, or ANY.
        publishers: those that were found.
        is_shared: whether several may publish on it.
    """

    name: str
    type: str
    publishers: Sequence[Publisher]
    is_shared: bool = False


class Fault(NamedTuple):
    """What is wrong with the publishers of a topic.

    Attributes:
        cause: one of ``causes``.
        subject: the topic, or a part of what it carries.
        reason: what is wrong, with node, machine and type.
        remedy: what to do about it.
    """

    cause: str
    subject: str
    reason: str
    remedy: str

    @property
    def text(self) -> str:
        """Reason and remedy, for a log line or a report."""
        return f"{self.reason}. {self.remedy}"


def find_faults(topic: CommandTopic) -> list[Fault]:
    """What is wrong with the publishers of a topic; nothing when there are none."""
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
    """The fault that several nodes command one thing; ``what`` is the beginning of its reason."""
    by_hand = [publisher.node for publisher in publishers if publisher.node.rpartition("/")[2].startswith(BY_HAND)]
    example = f"rosnode kill {by_hand[0]}" if by_hand else "rosnode kill ends a node"
    return Fault(causes.SECOND_PUBLISHER, subject,
                 f"{what}, {' and '.join(map(str, publishers))}: the newest message counts, so that each undoes what "
                 "the other commands", f"End all but the one that shall command: {example}")


class FaultLog:
    """How long faults have lasted, and which are due for a log line."""

    def __init__(self):
        self._since_ns: dict[tuple, int] = {}  # by cause and subject
        self._next_log_ns: dict[tuple, int] = {}

    def update(self, faults: Sequence[Fault], now_ns: int) -> list[Fault]:
        """Take the faults that there are now; returns those to be logged: lasting ones, at once and every 10 s."""
        keys = [(fault.cause, fault.subject) for fault in faults]
        self._since_ns = {key: self._since_ns.get(key, now_ns) for key in keys}
        self._next_log_ns = {key: at_ns for key, at_ns in self._next_log_ns.items() if key in keys or at_ns > now_ns}
        due = {key: fault for key, fault in zip(keys, faults)
               if self.is_lasting(fault, now_ns) and now_ns >= self._next_log_ns.get(key, now_ns)}
        self._next_log_ns.update(dict.fromkeys(due, now_ns + LOG_PERIOD_NS))
        return list(due.values())

    def is_lasting(self, fault: Fault, now_ns: int) -> bool:
        """Whether a fault is no passing one: a second publisher may be."""
        since_ns = self._since_ns.get((fault.cause, fault.subject), now_ns)
        return fault.cause != causes.SECOND_PUBLISHER or now_ns - since_ns >= LASTING_NS
