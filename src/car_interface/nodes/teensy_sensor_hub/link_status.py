"""How the link to the Teensy does, on teensy_sensor_hub's topic ~link and on /diagnostics."""
from __future__ import annotations

import math

from car_interface.common.units import NS_PER_S
from car_interface.msg import Error, LinkStatus
from car_interface.ros.topics import advertise
from car_interface.teensy.link.health import with_sonars
from car_interface.teensy.link.port import SerialLink
from car_interface.teensy.link.session import Session
from car_interface.teensy.sensing.sonar_monitor import SonarMonitor, describe

COUNTS = ("frames", "bad_frames", "malformed_frames", "unknown_commands", "noise_bytes", "resyncs", "reconnects",
          "reboots", "pings", "pongs", "firmware_checksum", "sonar_starts")


class LinkStatusPublisher:
    """Publishes the verdict on the link and the sonars behind it, and all counters; ``port`` is the port's path."""

    def __init__(self, port: str, link: SerialLink, session: Session, sonars: SonarMonitor, inbox):
        self._port = port
        self._link = link
        self._session = session
        self._sonars = sonars
        self._clocks = inbox.clocks
        self._topic = advertise("~link", LinkStatus, inbox, latch=True)

    def publish(self) -> None:
        self._topic.publish(self._status())

    def report(self, report):
        status = self._status()
        report.summary(status.level, f"{status.words}. {status.next_step}" if status.next_step else status.words)
        report.add("state", status.state)
        report.add("port", self._port)
        report.add("round trip", "never measured" if math.isnan(status.round_trip) else
                   f"{status.round_trip * 1e3:.1f} ms")
        for name in COUNTS:
            report.add(name.replace("_", " "), getattr(status, name))
        for counter in status.counters:
            report.add(f"Teensy's {counter.name}", counter.count)

    def _status(self):
        session = self._session
        tally, pinger, verdict = session.tally, session.pinger, session.health.verdict
        faults = self._sonars.faults(self._clocks.now_ns()) if self._link.is_open else ()
        if faults:
            verdict = with_sonars(verdict, *describe(faults))
        return LinkStatus(
            stamp=self._clocks.ros_now(), open=self._link.is_open, level=verdict.level, state=verdict.state,
            words=verdict.description, next_step=verdict.next_step, frames=tally.frames, bad_frames=tally.bad_frames,
            malformed_frames=session.malformed, unknown_commands=session.unknown_commands,
            noise_bytes=tally.noise_bytes, resyncs=session.resyncs, reconnects=max(0, session.openings - 1),
            reboots=session.reboots, pings=pinger.sent, pongs=pinger.answered,
            round_trip=session.round_trip_ns / NS_PER_S, firmware_checksum=pinger.checksum,
            sonar_starts=self._sonars.starts, dropped_sonars=list(self._sonars.dropped),
            counters=[Error(count, name) for name, count in sorted(session.counters.items())])
