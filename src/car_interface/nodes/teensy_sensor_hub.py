"""The teensy_sensor_hub node: the Teensy's serial link as topics and services.

Publishes:
    teensy_pong (Pong), teensy_wheel (Wheel), teensy_distance (Distance), teensy_error (Error): each valid frame.
    ~link (LinkStatus, latched, 1 Hz): frames good and bad, pings and pongs.
Services:
    ~ping, ~sonar_start, ~sonar_stop, ~wheel_reset, ~get_counters (std_srvs/Trigger),
    ~set_sonar_sequence (SetSonarSequence), ~set_sonar_wait (SetSonarWait).
Keys, on a terminal of its own:
    P ping, S sonar start, N sonar stop, R wheel reset, C counters, X sonars 0 1 5, Y all six sonars, Q quit.
Parameters:
    ~port /dev/ttyAMA0, ~baud 115200, ~ping_period 1.0 (s).
    ~firmware_checksum auto: which checksum the Teensy's receiver wants; shipped, corrected, or find out.
    ~required false: true = end with exit code 1 when the port can't be opened at start.
"""
from __future__ import annotations

import math
import time
from concurrent.futures import Future

import rospy
from std_srvs.srv import Trigger, TriggerResponse

from car_interface.errors import DeviceError, ProtocolError
from car_interface.msg import Distance, Error, LinkStatus, OneWheel, Pong, Wheel
from car_interface.nodes.keys import Keys
from car_interface.nodes.node import NS_PER_S, Complaints, Heartbeat, run
from car_interface.srv import SetSonarSequence, SetSonarSequenceResponse, SetSonarWait, SetSonarWaitResponse
from car_interface.teensy import protocol
from car_interface.teensy.framing import CORRECTED, RESYNC_FILLER, SHIPPED, FrameDecoder, encode
from car_interface.teensy.link import SerialLink
from car_interface.teensy.pinging import AUTO, Pinger

QUEUE_SIZE = 100  # a quarter of a second of a saturated line
FIRST_RETRY_NS, LAST_RETRY_NS = NS_PER_S // 5, 2 * NS_PER_S
COUNTERS_PERIOD_NS = NS_PER_S  # asked more often, the answers starve the Teensy's buffers
NOT_OPEN = (False, "the Teensy's port is not open")
KEY_HELP = "keys: P ping, S sonar start, N sonar stop, R wheel reset, C counters, X sonars 0 1 5, Y all sonars, Q quit"


class TeensySensorHub:
    """Keeps the link open and pinged, and passes on what comes through it."""

    def __init__(self, params, inbox):
        now_ns = time.monotonic_ns()
        port = params.text("port", "/dev/ttyAMA0")
        baud = params.integer("baud", 115200, low=300, high=4_000_000)
        period_s = params.number("ping_period", 1.0, low=0.01, high=3600)
        checksum = params.choice("firmware_checksum", AUTO, (AUTO, SHIPPED, CORRECTED))
        required = params.flag("required", False)
        params.finish()
        self._link = SerialLink(port, baud)
        self._decoder = FrameDecoder()
        self._pinger = Pinger(round(period_s * NS_PER_S), checksum, now_ns)
        self._inbox = inbox
        self._complaints = Complaints()
        self._retry_ns = FIRST_RETRY_NS
        self._next_try_ns = now_ns
        self._next_counters_ns = now_ns
        self._waiting = {}  # timestamp1 → the Futures of the ~ping calls that wait for it
        self._watched_fd = None
        self._round_trip_ns = math.nan
        self._link_beat = Heartbeat(1, now_ns)
        self._link_status = rospy.Publisher("~link", LinkStatus, queue_size=10, latch=True)
        self._publish = self._publishers()
        if required:
            self._open()
        self._services()
        self._key_actions = {
            "S": lambda: self._send(protocol.sonar_start()),
            "N": lambda: self._send(protocol.sonar_stop()),
            "R": lambda: self._send(protocol.wheel_reset()),
            "C": self._get_counters,
            "X": lambda: self._send(protocol.set_sonar_sequence((0, 1, 5))),
            "Y": lambda: self._send(protocol.set_sonar_sequence(range(len(protocol.SONARS)))),
        }
        self._keys = Keys()
        self._has_keys = self._keys.start()
        self._watches_keys = False
        if self._has_keys:
            rospy.loginfo(KEY_HELP)

    def _publishers(self):
        """What to do with each kind of record."""
        pong = rospy.Publisher("teensy_pong", Pong, queue_size=QUEUE_SIZE).publish
        wheel = rospy.Publisher("teensy_wheel", Wheel, queue_size=QUEUE_SIZE).publish
        distance = rospy.Publisher("teensy_distance", Distance, queue_size=QUEUE_SIZE).publish
        error = rospy.Publisher("teensy_error", Error, queue_size=QUEUE_SIZE).publish
        return {
            protocol.Pong: lambda record: (pong(*record), self._on_pong(record)),
            protocol.WheelStatus: lambda record: wheel(OneWheel(*record.left), OneWheel(*record.right)),
            protocol.SonarStatus: lambda record: distance(*record),
            protocol.ErrorCount: lambda record: error(*record),
            protocol.Malformed: lambda record: self._complaints.warn(
                "malformed", f"a frame from the Teensy makes no sense: {record.reason}"),
        }

    def _services(self):
        for name, action in (("sonar_start", protocol.sonar_start), ("sonar_stop", protocol.sonar_stop),
                             ("wheel_reset", protocol.wheel_reset)):
            self._serve(name, Trigger, TriggerResponse, lambda request, action=action: self._send(action()))
        self._serve("get_counters", Trigger, TriggerResponse, lambda request: self._get_counters())
        self._serve("ping", Trigger, TriggerResponse, lambda request: self._ping_and_wait())
        self._serve("set_sonar_sequence", SetSonarSequence, SetSonarSequenceResponse,
                    lambda request: self._send(protocol.set_sonar_sequence(request.sequence)))
        self._serve("set_sonar_wait", SetSonarWait, SetSonarWaitResponse,
                    lambda request: self._send(protocol.sonar_wait(request.wait_ms)))

    def _serve(self, name, service_type, response_type, action):
        """A service whose ``action(request)`` runs in the node's thread; it returns (success, message), or a Future."""
        def handle(request):
            done = Future()
            self._inbox.put(lambda item, now_ns: _answer(done, action, item), request)
            return response_type(*done.result())
        rospy.Service(f"~{name}", service_type, handle)

    def step(self, now_ns):
        """Do what was asked, read what came, ping when it's time."""
        for handler, item, arrival_ns in self._inbox.take():
            handler(item, arrival_ns)
        self._read_keys()
        if self._link.is_open:
            self._read()
        elif now_ns >= self._next_try_ns:
            self._try_open()
        if self._link.is_open:
            self._ping_when_due(time.monotonic_ns())
        if self._link_beat.is_due(now_ns):
            self._publish_link_status()
        return min(self._link_beat.due_ns,
                   self._pinger.next_event_ns() if self._link.is_open else self._next_try_ns)

    def shut_down(self):
        """Leave the terminal and the port as they were found."""
        self._keys.restore()
        self._close("the node ends")
        self._inbox.ending = True
        for handler, item, arrival_ns in self._inbox.take():
            handler(item, arrival_ns)

    def _try_open(self):
        try:
            self._open()
        except DeviceError as error:
            self._complaints.warn("port", f"{error}. Trying again")
            self._plan_retry()

    def _open(self):
        """Open the port, bring the Teensy's receiver in step, and ping it."""
        self._link.open()
        self._decoder.reset()
        self._watched_fd = self._link.fileno()
        self._inbox.watch(self._watched_fd)
        self._retry_ns = FIRST_RETRY_NS
        rospy.loginfo("the Teensy's port is open")
        self._pinger.restart(time.monotonic_ns())
        if self._write(RESYNC_FILLER):
            self._ping()

    def _plan_retry(self):
        self._next_try_ns = time.monotonic_ns() + self._retry_ns
        self._retry_ns = min(2 * self._retry_ns, LAST_RETRY_NS)

    def _close(self, reason):
        """Close the port and tell those who wait for an answer through it."""
        self._inbox.unwatch(self._watched_fd)
        self._link.close()
        for timestamp1 in list(self._waiting):
            self._tell_waiting(timestamp1, (False, reason))

    def _read(self):
        try:
            data = self._link.read()
        except DeviceError as error:
            self._lose(error)
            return
        for body in self._decoder.feed(data):
            record = protocol.decode(body)
            self._publish[type(record)](record)
        corrupt = self._decoder.tally.bad_frames - self._complaints.counts["corrupt"]
        if corrupt:
            self._complaints.warn("corrupt", "corrupt frames came from the Teensy", corrupt)

    def _lose(self, error):
        self._complaints.warn("port", f"{error}")
        self._close(str(error))
        self._plan_retry()

    def _write(self, data):
        """Send; whether the port took it."""
        try:
            self._link.write(data)
        except DeviceError as error:
            self._lose(error)
            return False
        return True

    def _ping_when_due(self, now_ns):
        before = self._pinger.checksum
        for timestamp1 in self._pinger.expire(now_ns):
            self._tell_waiting(timestamp1, (False, "no pong came back"))
            self._complaints.warn("ping", "a ping went unanswered")
        if self._pinger.checksum != before:
            self._complaints.warn("checksum",
                                  f"no ping is answered: trying the checksum of a {self._pinger.checksum} firmware")
        if now_ns >= self._pinger.due_ns:
            self._ping()

    def _ping(self):
        """Send a ping stamped with ROS time in ms, which is all that fits; the pinger keeps when that really was."""
        timestamp1 = rospy.Time.now().to_nsec() // 1_000_000 % protocol.UINT32
        self._write(self._pinger.ping(timestamp1, time.monotonic_ns()))
        return timestamp1

    def _on_pong(self, record):
        answer = self._pinger.pong(record.timestamp1, time.monotonic_ns())
        if answer is not None:
            self._round_trip_ns = answer.round_trip_ns
            self._tell_waiting(record.timestamp1, (True, f"pong after {answer.round_trip_ns / 1e6:.1f} ms"))

    def _publish_link_status(self):
        tally = self._decoder.tally
        self._link_status.publish(LinkStatus(
            stamp=rospy.Time.now(), open=self._link.is_open, frames=tally.frames, bad_frames=tally.bad_frames,
            malformed_frames=self._complaints.counts["malformed"], noise_bytes=tally.noise_bytes,
            pings=self._pinger.sent, pongs=self._pinger.answered, round_trip=self._round_trip_ns / NS_PER_S,
            firmware_checksum=self._pinger.checksum))

    def _tell_waiting(self, timestamp1, result):
        for future in self._waiting.pop(timestamp1, ()):
            future.set_result(result)

    def _ping_and_wait(self):
        if not self._link.is_open:
            return NOT_OPEN
        future = Future()
        self._waiting.setdefault(self._ping(), []).append(future)
        if not self._link.is_open:
            self._close(NOT_OPEN[1])
        return future

    def _send(self, body):
        """Send a command; (success, message) for a service."""
        if self._link.is_open and self._write(encode(body, self._pinger.checksum)):
            return True, "sent"
        return NOT_OPEN

    def _get_counters(self):
        now_ns = time.monotonic_ns()
        if now_ns < self._next_counters_ns:
            return False, "asked less than a second ago: the Teensy's buffers can't take more"
        result = self._send(protocol.get_counters())
        if result[0]:
            self._next_counters_ns = now_ns + COUNTERS_PERIOD_NS
        return result

    def _watch_keys(self, wanted):
        """Wait for the terminal only while its keys are ours to read: what isn't read stays readable for ever."""
        if wanted and self._has_keys and not self._watches_keys:
            self._inbox.watch(self._keys.fileno())
        elif self._watches_keys and not wanted:
            self._inbox.unwatch(self._keys.fileno())
        self._watches_keys = wanted and self._has_keys

    def _read_keys(self):
        typed = self._keys.read() if self._has_keys else ""
        self._watch_keys(typed is not None)
        for key in (typed or "").upper():
            if key == "Q":
                self._inbox.end()
            elif key == "P":
                self._ping_and_wait()
            elif key in self._key_actions:
                success, message = self._key_actions[key]()
                if not success:
                    rospy.logwarn("%s: %s", key, message)


def _answer(done, action, request):
    """Give ``done`` what ``action`` returns, now or, if that's a Future, when it's there."""
    try:
        result = action(request)
    except ProtocolError as error:
        result = (False, str(error))
    if isinstance(result, Future):
        result.add_done_callback(lambda future: done.set_result(future.result()))
    else:
        done.set_result(result)


def main():
    """Run the node."""
    run("teensy_sensor_hub", TeensySensorHub)
