"""The commands that reach the Teensy through teensy_sensor_hub: its services, and keys on a terminal of its own."""
from __future__ import annotations

from concurrent.futures import Future
from typing import Callable

import rospy
from std_srvs.srv import Trigger

from car_interface.common.errors import ProtocolError
from car_interface.common.units import NS_PER_S
from car_interface.nodes.terminal import Keys
from car_interface.ros.topics import serve
from car_interface.srv import SetSonarSequence, SetSonarWait
from car_interface.teensy.link import protocol
from car_interface.teensy.link.port import SerialLink
from car_interface.teensy.link.session import Session
from car_interface.teensy.sensing.sonar_monitor import SonarMonitor

COUNTERS_PERIOD_NS = NS_PER_S  # asked more often, the answers starve the Teensy's buffers
NOT_OPEN = (False, "the Teensy's port is not open")
KEY_HELP = "keys: P ping, S sonar start, N sonar stop, R wheel reset, C counters, X sonars 0 1 5, Y all sonars, Q quit"


class TeensyCommands:
    """Offers the services and reads the keys; each command returns (success, message), or a Future of it.

    Args:
        sonars: follow what is commanded.
        write: sends bytes and returns whether that worked.
        ping: sends a ping and returns its timestamp1.
    """

    def __init__(self, link: SerialLink, session: Session, sonars: SonarMonitor, write: Callable[[bytes], bool],
                 ping: Callable[[], int], inbox):
        self._link = link
        self._session = session
        self._sonars = sonars
        self._write = write
        self._ping = ping
        self._inbox = inbox
        self._next_counters_ns = 0
        self._waiting_pings = {}  # timestamp1 → the Futures of the ~ping calls that wait for it
        self._key_actions = {
            "P": self._ping_and_wait, "S": self._start_sonars, "N": self._stop_sonars, "R": self._reset_wheels,
            "C": self._get_counters, "X": lambda: self._set_sonar_sequence((0, 1, 5)),
            "Y": lambda: self._set_sonar_sequence(range(len(protocol.SONARS)))}
        self._keys = Keys()
        self._has_keys = self._watches_keys = False

    def start(self) -> None:
        for name, action in (("ping", self._ping_and_wait), ("sonar_start", self._start_sonars),
                             ("sonar_stop", self._stop_sonars), ("wheel_reset", self._reset_wheels),
                             ("get_counters", self._get_counters)):
            self._serve(name, Trigger, lambda request, action=action: action())
        self._serve("set_sonar_sequence", SetSonarSequence, lambda request: self._set_sonar_sequence(request.sequence))
        self._serve("set_sonar_wait", SetSonarWait, lambda request: self._set_sonar_wait(request.wait_ms))
        self._has_keys = self._keys.start()
        if self._has_keys:
            rospy.loginfo(KEY_HELP)

    def _serve(self, name, service_type, action):
        """Offer a service whose ``action(request)``, in the node's thread, returns (success, message) or a Future."""
        serve(f"~{name}", service_type, self._inbox, lambda request, done: _answer(done, action, request))

    def answer_ping(self, timestamp1: int, success: bool, message: str) -> None:
        """Answer the ~ping calls that wait for this ping's pong."""
        for future in self._waiting_pings.pop(timestamp1, ()):
            future.set_result((success, message))

    def answer_pings(self, success: bool, message: str) -> None:
        for timestamp1 in list(self._waiting_pings):
            self.answer_ping(timestamp1, success, message)

    def _ping_and_wait(self):
        if not self._link.is_open:
            return NOT_OPEN
        future = Future()
        self._waiting_pings.setdefault(self._ping(), []).append(future)
        if not self._link.is_open:
            self.answer_pings(*NOT_OPEN)
        return future

    def _send(self, body, note_sent=lambda: None, text="sent"):
        """Send a command, and have the fact noted; return (success, message) for a service."""
        if not (self._link.is_open and self._write(self._session.encode(body))):
            return NOT_OPEN
        note_sent()
        return True, text

    def _start_sonars(self):
        return self._send(protocol.START_SONARS, lambda: self._sonars.started(self._inbox.clocks.now_ns()))

    def _stop_sonars(self):
        return self._send(protocol.STOP_SONARS, self._sonars.stopped)

    def _set_sonar_sequence(self, sequence):
        return self._send(protocol.set_sonar_sequence(sequence),
                          lambda: self._sonars.sequence_set(sequence, self._inbox.clocks.now_ns()))

    def _set_sonar_wait(self, wait_ms):
        return self._send(protocol.sonar_wait(wait_ms), lambda: self._sonars.wait_set(wait_ms))

    def _reset_wheels(self):
        return self._send(protocol.RESET_WHEELS)

    def _get_counters(self):
        now_ns = self._inbox.clocks.now_ns()
        if now_ns < self._next_counters_ns:
            return False, "asked less than a second ago: the Teensy's buffers can't take more"

        def note_sent():
            self._next_counters_ns = now_ns + COUNTERS_PERIOD_NS
        return self._send(protocol.SEND_COUNTERS, note_sent, "sent; the counters come on teensy_error")

    def _watch_keys(self, wanted):
        """Wake on the terminal only while this process may read it: what isn't read stays readable for ever."""
        if wanted and self._has_keys and not self._watches_keys:
            self._inbox.watch(self._keys.fileno())
        elif self._watches_keys and not wanted:
            self._inbox.unwatch(self._keys.fileno())
        self._watches_keys = wanted and self._has_keys

    def read_keys(self) -> None:
        """Carry out the keys that were typed, if this node has a terminal of its own."""
        if not self._has_keys:
            return
        typed = self._keys.read()
        self._watch_keys(typed is not None)
        for key in (typed or "").upper():
            if key == "Q":
                self._inbox.end()
            elif key in self._key_actions:
                _when_done(self._key_actions[key](), lambda result, key=key: _log_key(key, *result))
            elif key.strip():
                rospy.loginfo(KEY_HELP)

    def restore_terminal(self) -> None:
        self._keys.restore()


def _answer(done, action, request):
    """Give ``done`` what ``action`` returns, now or, if that's a Future, when it's there."""
    try:
        result = action(request)
    except ProtocolError as error:
        result = (False, str(error))
    _when_done(result, done.set_result)


def _when_done(result, callback):
    """Call ``callback`` with the result, now or, if that's a Future, when it's there."""
    if isinstance(result, Future):
        result.add_done_callback(lambda future: callback(future.result()))
    else:
        callback(result)


def _log_key(key, success, message):
    (rospy.loginfo if success else rospy.logwarn)("%s: %s", key, message)
