"""Whether a node may register its name with the ROS master, while another node may have it. Pure.

The master gives a name to whoever registers it last and has the node before it shut down. Two nodes of a name, each of
them restarted by roslaunch when it ends, would replace each other for ever. So a node asks who has its name first.

- Nobody, or a node that refuses connections: a registration that a killed process left behind. It may register at once.
- A node that answers. It waits, however long that one runs.
- A node that doesn't answer, on a computer that may not answer either. It waits for ``MAX_SILENCE_S``. A node that
  drives a car on a busy computer answers within that time; one that is frozen for longer doesn't drive it.
- One that is about to register. It waits as long for that one to answer.
"""
from __future__ import annotations

from typing import NamedTuple

from car_interface.common.units import NS_PER_S

FREE, STARTING, RUNNING, SILENT, NO_MASTER = "free", "starting", "running", "silent", "no master"
MAX_SILENCE_S = 10
LOG_PERIOD_S = 10


class Holder(NamedTuple):
    """What has a node's name.

    Attributes:
        state: FREE, STARTING (about to register, on this computer), RUNNING (it answers), SILENT (it is registered and
            doesn't answer), or NO_MASTER (which doesn't answer; a node that was found before has ended).
        machine: where, for RUNNING and SILENT, e.g. ``127.0.0.1 (this computer)``.
        pid: the process there; 0 where unknown.
    """

    state: str
    machine: str = ""
    pid: int = 0

    def __str__(self) -> str:
        return f"on {self.machine}" + (f", process {self.pid}" if self.pid else "")


class NameWait:
    """Waits for a name.

    Args:
        name: the node's, with its namespace.
    """

    def __init__(self, name: str):
        self._name = name
        self._found: Holder | None = None  # the newest that was registered
        self._began_ns = self._log_ns = 0
        self._silent_since_ns: int | None = None
        self._reported_state = ""
        self.may_register = False

    def update(self, holder: Holder, now_ns: int) -> str:
        """Decide whether the node may register now; a line for the log, or an empty one."""
        if holder.state in (FREE, NO_MASTER):
            self._silent_since_ns = None
            return self._on_absence(holder.state, now_ns)
        if holder.state != STARTING:
            self._began_ns = now_ns if self._found is None else self._began_ns
            self._found = self._known(holder)
        if holder.state == RUNNING:
            self._silent_since_ns = None
        elif self._silent_since_ns is None:
            self._silent_since_ns = now_ns
        elif now_ns - self._silent_since_ns >= MAX_SILENCE_S * NS_PER_S:
            self.may_register = True
            return (f"{self._name} {self._found or holder} hasn't answered for {MAX_SILENCE_S} s: taking over. If it "
                    "is only frozen, the ROS master ends it when it wakes")
        return "" if holder.state == STARTING else self._waiting_text(holder.state, now_ns)

    def _known(self, holder):
        """The same with the process of an earlier answer, which a silent one doesn't give."""
        if holder.state == SILENT and self._found is not None and self._found.machine == holder.machine:
            return holder._replace(pid=self._found.pid)
        return holder

    def _on_absence(self, state, now_ns):
        if self._found is None or state == FREE:
            self.may_register = True
            return "" if self._found is None else f"{self._name} {self._found} has ended: taking over"
        return self._throttled(state, now_ns, f"{self._name} {self._found} has ended, and so has the ROS master. This "
                               "node waits for a master; end its launch file and start it again")

    def _waiting_text(self, state, now_ns):
        waited_s = (now_ns - self._began_ns) // NS_PER_S
        if state == SILENT:
            return self._throttled(state, now_ns, f"{self._name} is registered {self._found}, and doesn't answer. This "
                                   f"node takes over if it doesn't for {MAX_SILENCE_S} s")
        since = f"; waiting for {waited_s} s so far" if waited_s else ""
        return self._throttled(state, now_ns, f"{self._name} is already running {self._found}. This node waits, and "
                               "sends nothing, until that one ends; then it takes over. If a launch file was started "
                               f"twice, end one of the two{since}")

    def _throttled(self, state, now_ns, text):
        """The text when the state is new, and then every 10 s."""
        if state == self._reported_state and now_ns < self._log_ns:
            return ""
        self._reported_state, self._log_ns = state, now_ns + LOG_PERIOD_S * NS_PER_S
        return text
