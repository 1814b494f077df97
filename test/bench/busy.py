"""The car on a computer that is busy with other programs: latency, and timeouts that no input has caused.

Four loops that never rest run for each core. Gamepad, planner, odometry, e_stop and commands arrive without a break, so
each timeout that a node reports is a false one.
"""
from __future__ import annotations

import os
import re
import sys
import time
from collections import Counter
from contextlib import contextmanager
from typing import Iterator

from car_interface.msg import LinkStatus, SteeringState
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log
from std_msgs.msg import Bool, Int32MultiArray

from car_interface.common import causes

from .effort import Effort
from .reaction import TURN_ARB, reactions
from .rows import MEDIAN, P99, WORST, Row, Summary, Target
from .stage import Stage, TimedSubscriber
from .whole_car import ALL, SIMULATOR, launch_cars

CAR = "/busy"
CHANNELS = {"steering": 0, "ESC": 1}
CENTER = 5104  # of the steering, on the chip
SETTLED_S = 3.0  # after the car drives: all connections are made
LINKS = {"human_in_loop": causes.HUMAN_STALE, "tele_steer_req": causes.TELEOP_STALE,
         "av_turnrad_req": causes.PLANNER_STALE, "e_stop": causes.E_STOP_STALE}
ESC_LINKS = ("turn_arb's state", "tele_throt_req", "mode", "the planner's value", "odometry", "human_in_loop", "e_stop")


def measure_busy(effort: Effort, stage: Stage) -> Iterator[Row]:
    loops = 4 * (os.cpu_count() or 1)
    with busy(stage, loops):
        for what, times_ms, floors_ms in reactions(effort.busy_reactions, stage, TURN_ARB, kinds=1):
            yield Row("busy", f"{loops} busy loops: {what} → /servo/cmdVector", "ms", Summary.of(times_ms),
                      (Target(MEDIAN), Target(P99), Target(WORST)), Summary.of(floors_ms))
    with stage.running(*launch_cars(stage, [CAR], (*ALL, SIMULATOR), drive=("both",)),
                       stage.actor("timer", "100")), busy(stage, loops):
        time.sleep(SETTLED_S)
        watch = Watch()
        time.sleep(effort.busy_s)
        counts, gaps_ms = watch.end()
        floor = Summary.of(gaps_ms.pop("bare"))
    for link, count in counts.items():
        yield Row("busy", f"{loops} busy loops, {effort.busy_s:.0f} s: {link}", "times", Summary.of([count]),
                  (Target(high=0),), note=watch.lines.get(link, ""))
    for channel, gaps in gaps_ms.items():
        yield Row("busy", f"{loops} busy loops: commands of the {channel}, apart", "ms", Summary.of(gaps),
                  (Target(MEDIAN), Target(P99), Target(WORST)), floor if channel == "steering" else None,
                  note="with the delays of this measurement itself")


@contextmanager
def busy(stage: Stage, loops: int) -> Iterator[None]:
    """Keep all cores busy by programs in sessions of their own, as roslaunch starts them: Linux shares a core among
    sessions, then among the programs of each.
    """
    processes = [stage.start("setsid", sys.executable, "-c", "while True: pass") for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.clean_up()


class Watch:
    def __init__(self):
        self.lines: dict[str, str] = {}  # by link: the first log line about it
        self._causes = TimedSubscriber(f"{CAR}/turn_arb/state", SteeringState, lambda state: state.cause).connected()
        self._human = TimedSubscriber(f"{CAR}/teleop_logi/human_in_loop", Bool, lambda human: human.data).connected()
        self._outputs = TimedSubscriber(f"{CAR}/servo/output", Int32MultiArray, lambda output: output.data).connected()
        self._commands = TimedSubscriber(f"{CAR}/servo/cmdVector", Int32MultiArray, lambda command: command.data)
        self._bare = TimedSubscriber("/bench/timer", Int32MultiArray, lambda command: command.data)
        self._links = TimedSubscriber(f"{CAR}/teensy_sensor_hub/link", LinkStatus).connected()
        self._reports = TimedSubscriber("/diagnostics", DiagnosticArray).connected()
        self._log = TimedSubscriber("/rosout", Log, lambda line: (line.name, line.level, line.msg)).connected()
        time.sleep(1.1)  # a report of each node
        self._begin = self._numbers()
        for subscriber in (self._causes, self._human, self._outputs, self._commands, self._bare, self._log):
            subscriber.drain()

    def _numbers(self):
        """The counts that nodes publish: pings without a pong, timeouts of channels."""
        link = self._links.drain()[-1][1]
        numbers = Counter({"pings unanswered": link.pings - link.pongs, "the link reopened": link.reconnects})
        for _, array in self._reports.drain():
            for status in array.status:
                if status.name.startswith(f"{CAR[1:]}/pca9685"):
                    numbers.update({"timeouts": 0})
                    numbers["timeouts"] = sum(int(value.value) for value in status.values
                                              if value.key.startswith("timeouts of channel"))
        return numbers

    def end(self) -> tuple[dict[str, int], dict[str, list[float]]]:
        """Return how often each link timed out, and the ms between two commands of each channel."""
        found, commands, bare = Counter(), self._commands.drain(), self._bare.drain()
        changes = values(self._causes)
        for link, cause in LINKS.items():
            found[link] = rises([change == cause for change in changes])
        other_causes = set(changes) - set(LINKS.values()) - {causes.TELEOP, causes.PLANNER}
        if other_causes:
            self.lines["other stops of the steering"] = ", ".join(sorted(other_causes))
        for line in values(self._log):
            self._count_line(found, *line)
        at_center = [output[0] == CENTER for output in values(self._outputs)]
        numbers = self._numbers()
        numbers.subtract(self._begin)
        counts = {f"false timeouts of {link}": found[link] for link in LINKS}
        counts.update({f"false timeouts of the ESC's {link}": found[f"ESC {link}"] for link in ESC_LINKS})
        counts.update({
            "nodes that stood still": found["standstills"],
            "false timeouts of joy": rises([not human for human in values(self._human)]),
            "other stops of the steering": len(other_causes),
            "false timeouts of the board's channels": numbers["timeouts"],
            "the chip's steering at its center": rises(at_center),
            "pings unanswered": max(0, numbers["pings unanswered"] - 1),  # one may be on its way
            "the link reopened": numbers["the link reopened"], "warnings": found["warnings"]})
        gaps_ms = {name: apart_ms(commands, channel) for name, channel in CHANNELS.items()}
        return counts, {**gaps_ms, "bare": apart_ms(bare, 0)}

    def _count_line(self, found, name, level, text):
        if not name.startswith(f"{CAR}/"):
            return
        if level >= Log.WARN:
            found["warnings"] += 1
            self.lines.setdefault("warnings", f"{name}: {text}")
        if causes.NODE_STOOD_STILL in text:
            found["standstills"] += 1
            self.lines.setdefault("nodes that stood still", f"{name}: {text}")
        match = re.search(r"^[A-Z_]+: (.*?) silent", text)
        if match and name == f"{CAR}/throttle_arb":
            link = next((link for link in ESC_LINKS if match.group(1).startswith(link)), match.group(1))
            found[f"ESC {link}"] += 1
            self.lines.setdefault(f"false timeouts of the ESC's {link}", text)


def values(subscriber: TimedSubscriber) -> list:
    return [value for _, value in subscriber.drain()]


def rises(flags: list[bool]) -> int:
    return sum(now and not before for before, now in zip([False, *flags], flags))


def apart_ms(commands: list, channel: int) -> list[float]:
    times_ns = [at_ns for at_ns, duties in commands if duties[channel] != -1]
    return [(after - before) / 1e6 for before, after in zip(times_ns, times_ns[1:])]
