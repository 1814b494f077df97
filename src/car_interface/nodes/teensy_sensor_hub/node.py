"""The teensy_sensor_hub node: the Teensy's serial link as topics and services, and what its numbers mean.

Publishes:
    teensy_pong (Pong), teensy_wheel (Wheel), teensy_distance (Distance), teensy_error (Error): each valid frame.
    odom (nav_msgs/Odometry), joint_states (sensor_msgs/JointState: the rear wheels), /tf from odom to base_link: by the
        newest report of the wheels, 5 to 50 Hz (~odom_rate), stamped when the wheels were so.
    sonar/front_right … sonar/rear_left (sensor_msgs/Range): about 3 Hz each, stamped when the echo came; where the
        sonars sit goes to /tf_static.
    teensy_clock (TeensyClock): with each answered ping, how the Teensy's clock relates to this computer's.
    ~link (LinkStatus, latched, 1 Hz and when the port opens or closes): what is wrong with the link, and its counters.
    /diagnostics: the same, the clock, and the records that made no sense; 1 Hz.
Subscribes:
    temperature (sensor_msgs/Temperature, °C): of the air, for the speed of sound; without it ~temperature counts.
    turn_arb/state (SteeringState), with ~use_steering: the commanded turn radius, which helps the heading.
Services:
    ~ping, ~sonar_start, ~sonar_stop, ~wheel_reset, ~get_counters (std_srvs/Trigger),
    ~set_sonar_sequence (SetSonarSequence), ~set_sonar_wait (SetSonarWait).
Keys, on a terminal of its own:
    P ping, S sonar start, N sonar stop, R wheel reset, C counters, X sonars 0 1 5, Y all six sonars, Q quit.
Argument, by a launch file: --port, which ~port must agree with: see ``common.fixed_parameters``.
"""
from __future__ import annotations

import math

import rospy

from car_interface.common.declared import read_all
from car_interface.common.errors import DeviceError
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import NS_PER_S
from car_interface.msg import Distance, Error, LinkStatus, OneWheel, Pong, Wheel
from car_interface.nodes.teensy_sensor_hub.config import HubConfig
from car_interface.nodes.teensy_sensor_hub.measurement_publisher import MeasurementPublisher
from car_interface.nodes.teensy_sensor_hub.teensy_commands import TeensyCommands
from car_interface.ros.diagnostics import Diagnostics
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, has_subscribers
from car_interface.teensy.link import protocol
from car_interface.teensy.link.health import FINE, LINK_REPORT, OK, REBOOTED, WAITING, with_sonars
from car_interface.teensy.link.port import SerialLink
from car_interface.teensy.link.session import PongReceived, Rebooted, Session
from car_interface.teensy.sensing.sonar_monitor import SEND_SEQUENCE, SonarMonitor, describe

QUEUE_SIZE = 100  # a quarter of a second of a saturated line
FIRST_RETRY_NS, LAST_RETRY_NS = NS_PER_S // 5, 2 * NS_PER_S
LONG_READ = 1024  # bytes: 90 ms of a saturated line at 115200 baud. So much at once that is no frames is a flood
SHORTEST_REST_NS = NS_PER_S // 250
COUNTS = ("frames", "bad_frames", "malformed_frames", "unknown_commands", "noise_bytes", "resyncs", "reconnects",
          "reboots", "pings", "pongs", "firmware_checksum", "sonar_starts")


class TeensySensorHub:
    """Keeps the port open, runs the session over it, and publishes what comes through it."""

    def __init__(self, params, inbox, make_link=SerialLink):
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        config = read_all(params, HubConfig)
        self._measurements = None if config.raw_only else MeasurementPublisher(config, inbox)
        self._port = config.port
        self._link = make_link(config.port, config.baud)
        self._session = Session(config.baud, round(config.ping_period_s * NS_PER_S), config.firmware_checksum, now_ns)
        self._sonars = SonarMonitor(config.sonar_restart_s, map(int, config.sonar_sequence),
                                    map(int, config.sonar_sequence_ahead))
        if self._measurements:
            self._sonars.clones = self._measurements.ranging.clones
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._retry_ns = FIRST_RETRY_NS
        # Until when the port is left alone: it couldn't be opened, was lost, or there was a flood; 0 = it isn't.
        self._rest_until_ns = 0
        self._link_timer = RateTimer(1, now_ns)
        self._status_topic = advertise("~link", LinkStatus, inbox, latch=True)
        self._diagnostics = Diagnostics(inbox, f"Teensy on {config.port}", {
            LINK_REPORT: self._report_link, **(self._measurements.reports if self._measurements else {})},
            now_ns)
        self._commands = TeensyCommands(self._sonars, self._send, self._ping, inbox)
        self._handlers = self._event_handlers()
        if config.required:
            self._open()
        self._commands.start()

    def _event_handlers(self):
        """Return a handler for each type of event, called with the read's time; records are first published raw."""
        pong = advertise("teensy_pong", Pong, self._inbox, QUEUE_SIZE).publish
        wheel = advertise("teensy_wheel", Wheel, self._inbox, QUEUE_SIZE)
        distance = advertise("teensy_distance", Distance, self._inbox, QUEUE_SIZE)
        error = advertise("teensy_error", Error, self._inbox, QUEUE_SIZE).publish
        measurements = self._measurements

        def on_pong(event, received_ns):
            record, answer = event
            pong(*record)
            self._sonars.tick(record.timestamp2, received_ns)
            if answer is not None:
                self._commands.answer_ping(record.timestamp1, True, f"pong after {answer.round_trip_ns / 1e6:.1f} ms")
            if measurements:
                measurements.pong(record, answer, received_ns)

        def on_wheels(record, received_ns):
            if has_subscribers(wheel):
                wheel.publish(OneWheel(*record.left), OneWheel(*record.right))
            if measurements:
                measurements.wheels(record, received_ns)

        def on_sonar(record, received_ns):
            if has_subscribers(distance):
                distance.publish(*record)
            is_trusted = self._sonars.report(record.sensor, record.echo_us, record.when, received_ns)
            if measurements:
                measurements.sonar(record, received_ns, is_trusted, self._sonars.wait_ms)
                while measurements.ranging.blinks:
                    self._sonars.blinked[measurements.ranging.blinks.pop()] = received_ns

        return {PongReceived: on_pong, protocol.WheelStatus: on_wheels, protocol.SonarStatus: on_sonar,
                protocol.ErrorCount: lambda record, received_ns: error(*record),
                protocol.Malformed: lambda record, received_ns: self._warnings.warn(
                    "malformed", f"a frame from the Teensy makes no sense: {record.reason}"),
                Rebooted: self._on_reboot}

    def step(self, now_ns):
        """Handle requests, read the port, ping, judge, publish; returns when to be called next."""
        self._inbox.dispatch()
        self._commands.read_keys()
        port_ns = self._attend_port(now_ns)
        if self._measurements:
            self._measurements.step(now_ns)
        if self._link_timer.is_due(now_ns):
            self._judge()
            self._judge_sonars()
            self._publish_status()
        self._diagnostics.step(now_ns)
        return min(self._link_timer.due_ns, self._diagnostics.due_ns, port_ns,
                   self._measurements.due_ns if self._measurements else math.inf)

    def _attend_port(self, now_ns):
        """Read it and ping through it, or try to open it; returns when that is due again though nothing comes."""
        if now_ns >= self._rest_until_ns and self._link.is_open:
            self._read(now_ns)
        elif now_ns >= self._rest_until_ns:
            try:
                self._open()
            except DeviceError as error:
                self._warnings.warn(error.state, f"{error}. Trying again")
                self._retry_after(error)
        if self._link.is_open and now_ns >= self._session.pinger.next_event_ns():
            self._ping_when_due(now_ns)
        ping_ns = self._session.pinger.next_event_ns() if self._link.is_open else math.inf
        return min(ping_ns, self._rest_until_ns or math.inf)

    def shut_down(self):
        self._commands.keys.restore()
        self._close("the node ends")
        self._inbox.ending = True
        self._inbox.dispatch()

    def _open(self):
        """Open the port, bring the Teensy's receiver in step, and ping it."""
        self._link.open()
        self._begin_reading()
        rospy.loginfo("the Teensy's port is open")
        now_ns = self._clocks.now_ns()
        self._session.opened(now_ns)
        self._sonars.opened(now_ns)
        self._publish_status()
        self._ping()

    def _begin_reading(self):
        self._rest_until_ns = 0
        self._inbox.watch("port", self._link.fileno())

    def _close(self, reason):
        """Close the port and answer the ~ping calls that wait for it."""
        self._inbox.watch("port", None)
        self._link.close()
        self._commands.answer_pings(False, reason)

    def _read(self, began_ns):
        try:
            data = self._link.read()
        except DeviceError as error:
            self._lose(error)
            return
        received_ns = self._clocks.now_ns()
        self._begin_reading()
        if not data:
            return
        self._retry_ns = FIRST_RETRY_NS
        tally = self._session.tally
        noise_bytes, bad_frames = tally.noise_bytes, tally.bad_frames
        for event in self._session.receive(data, received_ns):
            self._sonars.frame(received_ns)
            self._handlers[type(event)](event, received_ns)
        self._note_noise(tally.noise_bytes - noise_bytes, tally.bad_frames - bad_frames, len(data), began_ns)

    def _note_noise(self, noise_bytes, corrupt, read_bytes, began_ns):
        """Warn of corrupt frames. After a long read that is mostly noise leave the port alone for as long as it took.

        A flood must not take the whole CPU.
        """
        if corrupt:
            self._warnings.warn("corrupt", "corrupt frames came from the Teensy", corrupt)
        if read_bytes >= LONG_READ and 2 * noise_bytes > read_bytes:
            now_ns = self._clocks.now_ns()
            self._rest_until_ns = now_ns + max(now_ns - began_ns, SHORTEST_REST_NS)
            self._inbox.watch("port", None)  # unread it would end every wait

    def _lose(self, error):
        self._warnings.warn(error.state, f"{error}")
        self._close(str(error))
        self._retry_after(error)

    def _retry_after(self, error):
        """Plan the next try. That the port is gone is published at once; that it still is waits for the next second."""
        before = self._session.health.verdict.state
        self._session.health.port_failed(error.state, error.cause, error.remedy)
        if error.state != before:
            self._publish_status()
        self._rest_until_ns = self._clocks.now_ns() + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, LAST_RETRY_NS)

    def _send(self, body):
        """Send a command; return whether that worked."""
        return self._write(self._session.encode(body))

    def _write(self, data):
        """Write to the port if it is open; return whether that worked."""
        if not self._link.is_open:
            return False
        try:
            self._link.write(data)
        except DeviceError as error:
            self._lose(error)
            return False
        return True

    def _ping_when_due(self, now_ns):
        checksum = self._session.pinger.checksum
        for timestamp1 in self._session.expire(now_ns):
            self._commands.answer_ping(timestamp1, False, "no pong came back")
            self._warnings.warn("ping", "a ping went unanswered")
        if self._session.pinger.checksum != checksum:
            self._warnings.warn("checksum", "no ping is answered: trying the checksum of a "
                                            f"{self._session.pinger.checksum} firmware")
        if now_ns >= self._session.pinger.due_ns:
            self._ping()

    def _ping(self):
        """Send a ping stamped with ROS time in ms, which is all that fits; return that, or ``None`` = it wasn't sent.

        The session keeps its monotonic time.
        """
        timestamp1 = self._clocks.ros_now().to_nsec() // 1_000_000 % protocol.UINT32
        is_sent = self._link.is_open and self._write(self._session.ping(timestamp1, self._clocks.now_ns()))
        return timestamp1 if is_sent else None

    def _on_reboot(self, event, received_ns):
        self._sonars.rebooted(received_ns)
        self._warnings.warn("rebooted", f"the Teensy rebooted: {event.description}")

    def _judge(self):
        """Judge the link; log what is new, or still bad. A port that fails is logged by itself."""
        if not self._link.is_open:
            return
        before = self._session.health.verdict
        verdict = self._session.judge(self._clocks.now_ns())
        is_news = verdict.state != before.state
        if verdict.level != OK and verdict.state not in (WAITING, REBOOTED):  # a reboot was logged as it was detected
            self._warnings.warn(verdict.state, f"Teensy on {self._port}: {verdict.description}. {verdict.next_step}",
                                int(is_news))
        elif verdict.state == FINE and is_news:
            rospy.loginfo("Teensy on %s: %s", self._port, verdict.description)

    def _judge_sonars(self):
        """Send the commands that the sonars need, and warn of their faults."""
        now_ns = self._clocks.now_ns()
        if self._measurements:
            self._sonars.update_speed(self._measurements.speed_mps, now_ns)
        command = self._sonars.next_command(now_ns) if self._link.is_open else None
        if command == SEND_SEQUENCE:
            self._send(protocol.set_sonar_sequence(self._sonars.sequence))
        elif command:
            self._warnings.warn("sonar start", "no sonar has reported for a while: SONAR_START was sent")
            self._send(protocol.START_SONARS)
        faults = self._sonars.faults(now_ns)
        if faults:
            kind = f"sonars {sorted(str(fault.sensor) for fault in faults)}"
            self._warnings.warn(kind, "{}. {}".format(*describe(faults)))

    def _publish_status(self):
        self._status_topic.publish(self._status())

    def _report_link(self, report):
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


def main():
    run("teensy_sensor_hub", TeensySensorHub)
