"""The commands that reach the Teensy through teensy_sensor_hub: its services, and keys on a terminal of its own."""
from __future__ import annotations

from concurrent.futures import InvalidStateError
from contextlib import suppress
from typing import Callable

import rospy
from std_srvs.srv import Trigger

from car_interface.common.errors import ProtocolError
from car_interface.common.units import NS_PER_S
from car_interface.nodes.terminal import Keys
from car_interface.ros.topics import serve
from car_interface.srv import SetSonarSequence, SetSonarSequenceRequest, SetSonarWait
from car_interface.teensy.link import protocol
from car_interface.teensy.sensing.sonar_monitor import SonarMonitor

COUNTERS_PERIOD_NS = NS_PER_S  # asked more often, the answers starve the Teensy's buffers
NOT_OPEN = (False, "the Teensy's port is not open")
KEYS = {  # the service that each calls, and its request
    "P": ("ping", None), "S": ("sonar_start", None), "N": ("sonar_stop", None), "R": ("wheel_reset", None),
    "C": ("get_counters", None), "X": ("set_sonar_sequence", SetSonarSequenceRequest((0, 1, 5))),
    "Y": ("set_sonar_sequence", SetSonarSequenceRequest(range(len(protocol.SONARS))))}
KEY_HELP = "keys: P ping, S sonar start, N sonar stop, R wheel reset, C counters, X sonars 0 1 5, Y all sonars, Q quit"


class TeensyCommands:
    """Offers the services and reads the keys. Each command takes what its answer goes to, as (success, message).

    Args:
        sonars: follow what is commanded.
        send: sends a command and returns whether that worked.
        ping: sends a ping and returns its timestamp1, or ``None`` if that didn't work.

    Attributes:
        keys: of the node's terminal.
    """

    def __init__(self, sonars: SonarMonitor, send: Callable[[bytes], bool], ping: Callable[[], int | None], inbox):
        self._send_body, self._ping, self._inbox = send, ping, inbox
        self._next_counters_ns = 0
        self._waiting_pings = {}  # timestamp1 → the answers of the ~ping calls that wait for it
        now_ns = inbox.clocks.now_ns
        self._services = {
            "ping": (Trigger, self._ping_and_wait),
            "sonar_start": (Trigger, lambda answer, request: self._send(
                answer, protocol.START_SONARS, lambda: sonars.started(now_ns()))),
            "sonar_stop": (Trigger, lambda answer, request: self._send(
                answer, protocol.STOP_SONARS, sonars.stopped)),
            "wheel_reset": (Trigger, lambda answer, request: self._send(answer, protocol.RESET_WHEELS)),
            "get_counters": (Trigger, self._get_counters),
            "set_sonar_sequence": (SetSonarSequence, lambda answer, request: self._send(
                answer, protocol.set_sonar_sequence(request.sequence),
                lambda: sonars.sequence_set(request.sequence, now_ns()))),
            "set_sonar_wait": (SetSonarWait, lambda answer, request: self._send(
                answer, protocol.sonar_wait(request.wait_ms), lambda: sonars.wait_set(request.wait_ms)))}
        self.keys = Keys()
        self._has_keys = False

    def start(self) -> None:
        for name, (service_type, action) in self._services.items():
            self._serve(name, service_type, action)
        self._has_keys = self.keys.start()
        if self._has_keys:
            rospy.loginfo(KEY_HELP)

    def _serve(self, name, service_type, action):
        """Offer a service by ``action(answer, request)``, in the node's thread."""
        def handle(request, done):
            def answer(success, message):
                with suppress(InvalidStateError):  # the node ended meanwhile
                    done.set_result((success, message))
            try:
                action(answer, request)
            except ProtocolError as error:
                answer(False, str(error))
        serve(f"~{name}", service_type, self._inbox, handle)

    def answer_ping(self, timestamp1: int, success: bool, message: str) -> None:
        """Answer the ~ping calls that wait for this ping's pong."""
        for answer in self._waiting_pings.pop(timestamp1, ()):
            answer(success, message)

    def answer_pings(self, success: bool, message: str) -> None:
        for timestamp1 in list(self._waiting_pings):
            self.answer_ping(timestamp1, success, message)

    def _ping_and_wait(self, answer, request):
        timestamp1 = self._ping()
        if timestamp1 is None:
            answer(*NOT_OPEN)
        else:
            self._waiting_pings.setdefault(timestamp1, []).append(answer)

    def _send(self, answer, body, note_sent=lambda: None, text="sent"):
        """Send a command, and have the fact noted."""
        is_sent = self._send_body(body)
        if is_sent:
            note_sent()
        answer(*((True, text) if is_sent else NOT_OPEN))

    def _get_counters(self, answer, request):
        now_ns = self._inbox.clocks.now_ns()
        if now_ns < self._next_counters_ns:
            answer(False, "asked less than a second ago: the Teensy's buffers can't take more")
            return

        def note_sent():
            self._next_counters_ns = now_ns + COUNTERS_PERIOD_NS
        self._send(answer, protocol.SEND_COUNTERS, note_sent, "sent; the counters come on teensy_error")

    def read_keys(self) -> None:
        """Carry out the keys that were typed, if this node has a terminal of its own."""
        if not self._has_keys:
            return
        typed = self.keys.read()
        # A terminal that this process may not read stays readable for ever, and would wake it all the time.
        self._inbox.watch("keys", None if typed is None else self.keys.fileno())
        for key in (typed or "").upper():
            if key == "Q":
                self._inbox.end()
            elif key in KEYS:
                name, request = KEYS[key]
                self._services[name][1](lambda success, message, key=key: (
                    rospy.loginfo if success else rospy.logwarn)("%s: %s", key, message), request)
            elif key.strip():
                rospy.loginfo(KEY_HELP)
