"""How the Teensy's serial link, its clock and its counters did."""
from __future__ import annotations

from typing import Any, Mapping

from car_interface.common.units import NS_PER_S, stamp_ns
from car_interface.tools.report.downsample import Trace
from car_interface.tools.report.faults import WARN, FaultLog

CLOCK_SET_S = 0.05  # a change between ROS time and the monotonic clock from one pong to the next
MIN_SPAN_S = 0.5  # over which frames are counted
TRACES = ("frames", "bad frames", "round trip", "skew", "uncertainty")


class TeensyWatch:
    """Follows the hub's link status, the pongs and the Teensy's counters.

    Args:
        traces: those of TRACES are written to: frames per s, round trip in ms, skew in ppm, uncertainty in ms.
        faults: what the hub reports, reboots, and changes of the computer's clock are added.

    Attributes:
        first_link, link: the first and a recent LinkStatus; ``None`` without any.
        counters: (first, last) value by name.
        pongs, pongs_unused: how many, and how many of them were not used for the clock.
    """

    def __init__(self, traces: Mapping[str, Trace], faults: FaultLog):
        self._traces, self._faults = traces, faults
        self.first_link = self.link = None
        self.counters: dict = {}
        self.pongs = self.pongs_unused = 0
        self._link_s = 0.0
        self._monotonic_offset_ns = None

    def on_link(self, time_s: float, message: Any) -> None:
        """car_interface/LinkStatus."""
        before, span_s = self.link, time_s - self._link_s
        if before is None:
            self.first_link = message
        else:
            if span_s > MIN_SPAN_S:
                self._traces["frames"].add(time_s, (message.frames - before.frames) / span_s)
                self._traces["bad frames"].add(time_s, (message.bad_frames - before.bad_frames) / span_s)
            for name, what in (("reconnects", "the port was opened again"), ("reboots", "the Teensy started anew")):
                if getattr(message, name) > getattr(before, name):
                    self._faults.add_moment(time_s, WARN, "Teensy", what)
        if before is None or span_s > MIN_SPAN_S:
            self.link, self._link_s = message, time_s
        what = ". ".join(filter(None, (message.words, message.next_step)))
        self._faults.update_condition(time_s, "link", message.level, "Teensy", f"{message.state}: {what}")
        for counter in message.counters:
            self.on_error(time_s, counter)

    def on_clock(self, time_s: float, message: Any) -> None:
        """car_interface/TeensyClock, one for each pong."""
        self.pongs += 1
        self.pongs_unused += not message.used
        self._traces["round trip"].add(time_s, message.round_trip * 1e3)
        if message.converged:
            self._traces["skew"].add(time_s, message.skew)
            self._traces["uncertainty"].add(time_s, message.uncertainty * 1e3)
        offset_ns, before_ns = stamp_ns(message.stamp) - message.received, self._monotonic_offset_ns
        step_s = 0.0 if before_ns is None else (offset_ns - before_ns) / NS_PER_S
        if abs(step_s) > CLOCK_SET_S:
            self._faults.add_moment(time_s, WARN, "computer", f"its clock was set by {step_s:+.3f} s")
        self._monotonic_offset_ns = offset_ns

    def on_error(self, time_s: float, message: Any) -> None:
        """car_interface/Error: the value of a counter."""
        first, _ = self.counters.get(message.name, (message.count, None))
        self.counters[message.name] = (first, message.count)
