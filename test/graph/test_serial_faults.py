"""Every fault of the Teensy's serial line: the hub says which one it is and what to do, survives it, and goes on."""
from __future__ import annotations

from types import SimpleNamespace
from typing import NamedTuple

import pytest
from car_interface.msg import LinkStatus
from car_interface.srv import InjectFaultRequest
from std_srvs.srv import TriggerRequest

from car_interface.nodes.teensy_sensor_hub.node import TeensySensorHub
from graph import NS_PER_S

OK, WARN, ERROR = LinkStatus.OK, LinkStatus.WARN, LinkStatus.ERROR
LINK, REPORT = "/teensy_sensor_hub/link", "teensy_sensor_hub: Teensy link"
SETTLED_S = 3.2


class Line:
    """A hub and a virtual Teensy on a line with faults."""

    def __init__(self, car, hub=None, **sim):
        self.car, self.graph = car, car.graph
        self.graph.record(LINK, "/teensy_pong", "/teensy_distance")
        car.sim(seed=3, **sim)
        self.hub = car.hub(**(hub or {}))

    def settled(self, phase_s=0.0):
        self.graph.run(SETTLED_S + phase_s)
        assert self.link.state == "fine"
        return self

    @property
    def link(self):
        return self.graph.newest(LINK)

    def inject(self, fault, value=0.0):
        self.car.inject(fault, value)
        return self.graph.now_ns

    def call(self, name):
        answer = self.graph.call(f"/teensy_sensor_hub/{name}", TriggerRequest())
        return answer.success, answer.message

    def seconds_until(self, state):
        """Let time go on until that is the state of the link; return for how long it did."""
        begun_ns = self.graph.now_ns
        return (self.graph.run_until(lambda: self.link.state == state, 30.0) - begun_ns) / NS_PER_S


@pytest.fixture
def line(car):
    return Line(car)


class Fault(NamedTuple):
    """A fault of the line, what the hub makes of it and within which time, and how long that stays afterwards."""

    fault: str
    value: float
    state: str
    level: int
    words: str
    next_step: str
    found_s: float = 3.0  # in two judgements, one a second, of a whole second each
    ended_s: float = 3.0


FAULTS = [
    Fault("silence", 60, "silent", ERROR, "the port is open, but nothing comes", "TX leads to this port's RX"),
    Fault("scramble", 60, "no frames", ERROR, "bytes a second come, but no frames", "~baud 115200"),
    Fault("flood", 60, "no frames", ERROR, "more than 115200 baud can carry", "~baud 115200"),
    Fault("bit_errors", 0.002, "bad checksums", WARN, "% of them are corrupt", "serial cable", 4.0, 12.0),
    Fault("bit_errors", 0.02, "bad checksums", ERROR, "frames come, but", "serial cable", 4.0, 12.0),
    Fault("unplug", 0, "port absent", ERROR, "there is no such port", "Plug the Teensy in", 0.3, 4.1)]


@pytest.mark.once
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.fault}_{fault.value}")
def test_fault_is_told_on_the_link_and_in_the_diagnostics_and_goes_with_it(line, fault):
    line.settled(phase_s=0.37)  # between two judgements
    line.inject(fault.fault, fault.value)
    assert line.seconds_until(fault.state) <= fault.found_s
    line.graph.run(3.0)
    link = line.link
    assert (link.state, link.level, link.open) == (fault.state, fault.level, fault.fault != "unplug")
    assert fault.words in link.words and fault.next_step in link.next_step
    report = line.graph.report(REPORT)
    assert report.level == fault.level and report.values["state"] == fault.state
    assert fault.next_step in report.message and fault.words in report.message
    line.inject("plug" if fault.fault == "unplug" else fault.fault, 0)
    assert line.seconds_until("fine") <= fault.ended_s
    assert line.link.level == OK
    assert line.call("ping")[0]


@pytest.mark.parametrize("fault, value, text", [
    ("reboot", 0.0, "the Teensy rebooted"), ("cut", 5, "corrupt frames came from the Teensy"),
    ("out_of_step", 0.0, "a ping went unanswered")])
def test_fault_that_is_over_at_once_is_logged_and_the_link_goes_on(line, fault, value, text):
    line.settled()
    begun_ns = line.inject(fault, value)
    line.graph.run(3.0)
    assert any(each.startswith(text) for each in line.graph.lines("/teensy_sensor_hub", begun_ns))
    assert (line.link.reboots, line.link.state == "rebooted") == ((1, True) if fault == "reboot" else (0, False))
    assert line.call("ping")[0]


@pytest.mark.more
def test_reboot_while_unplugged_is_found_though_the_teensy_has_been_on_for_as_long_as_before(car):
    line = Line(car, clock_start_ms=300).settled()
    line.inject("unplug")
    line.graph.run(1.0)
    line.inject("reboot")
    line.graph.run(8.0)
    begun_ns = line.inject("plug")
    line.graph.run(4.0)
    assert line.link.reboots == 1
    assert any(each.startswith("the Teensy rebooted: its clock went from 14.5 s back to 10.0 s")
               for each in line.graph.lines("/teensy_sensor_hub", begun_ns))
    line.inject("unplug")
    line.graph.run(8.0)
    line.inject("plug")
    line.graph.run(8.0)
    assert (line.link.reboots, line.link.state) == (1, "fine")


@pytest.mark.parametrize("noise, read, rests", [(513, 1024, True), (512, 1024, False), (1023, 1023, False)])
def test_hub_leaves_a_port_alone_that_brought_more_noise_than_frames_at_once(noise, read, rests):
    watches = []
    hub = SimpleNamespace(_clocks=SimpleNamespace(now_ns=lambda: 20_000_000), _rest_until_ns=0,
                          _inbox=SimpleNamespace(watch=lambda what, fd: watches.append(fd)))
    TeensySensorHub._note_noise(hub, noise, 0, read, 9_000_000)
    assert (watches, hub._rest_until_ns) == (([None], 31_000_000) if rests else ([], 0))


def test_fault_and_recovery_are_logged_once_each(line):
    line.settled()
    begun_ns = line.inject("silence", 5)
    line.graph.run(10)
    lines = line.graph.lines("/teensy_sensor_hub", begun_ns)
    assert lines[0].startswith("a ping went unanswered")
    assert lines[1:] == [
        ("Teensy on /dev/ttyAMA0: the port is open, but nothing comes from it. Check the Teensy's power and that its "
         "TX leads to this port's RX; is it the right ~port?"), line.graph.lines("/teensy_sensor_hub")[-1]]
    assert lines[-1].startswith("Teensy on /dev/ttyAMA0: fine: ")


def test_link_that_is_fine_says_so_and_carries_its_counters(line):
    line.settled()
    assert line.call("get_counters")[0]
    line.graph.run(1.5)
    link, report = line.link, line.graph.report(REPORT)
    assert (link.state, link.level, link.open, link.next_step) == ("fine", OK, True, "")
    assert link.words == f"fine: {link.words.split()[1]} frames a second"
    assert link.frames > 0 and 0.002 <= link.round_trip <= 0.02
    assert {counter.name: counter.count for counter in link.counters}["rxPackets"] > 0
    assert report.message == link.words and report.values["port"] == "/dev/ttyAMA0"
    for key in ("frames", "bad frames", "malformed frames", "unknown commands", "noise bytes", "resyncs", "reconnects",
                "reboots", "pings", "pongs", "firmware checksum", "sonar starts"):
        assert report.values[key] == str(getattr(link, key.replace(" ", "_")))
    assert report.values["round trip"] == f"{1e3 * link.round_trip:.1f} ms"
    assert int(report.values["Teensy's rxPackets"]) > 0


def test_port_that_is_missing_at_the_start_is_waited_for(car):
    car.graph.record(LINK)
    car.hub()
    car.graph.run(5.5)
    link = car.graph.newest(LINK)
    assert (link.state, link.open, link.next_step) == ("port absent", False, "Plug the Teensy in")
    assert "there is no such port" in car.graph.lines("/teensy_sensor_hub")[0]
    car.sim()
    car.graph.run_until(lambda: car.graph.newest(LINK).state == "fine", 4.0)
    assert car.graph.newest(LINK).reconnects == 0


@pytest.mark.parametrize("fault, value, reason", [
    ("explode", 1, "there is no fault 'explode', only bit_errors, cut, flood, out_of_step, plug"),
    ("unplug", -1, "unplug is -1.0; accepted: 0 (until plug) to 3600 s"),
    ("sonar_stuck", 6, "accepted: a sensor from 0 to 5")])
def test_fault_that_there_is_not_and_value_that_cannot_be_are_refused(car, fault, value, reason):
    car.sim()
    answer = car.graph.call("/car_sim/inject_fault", InjectFaultRequest(fault, value))
    assert not answer.success and reason in answer.message
