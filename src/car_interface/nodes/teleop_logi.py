"""The teleop_logi node: converts a gamepad's messages to steering and throttle requests and the deadman.

Subscribes:
    joy (sensor_msgs/Joy).
    phone/joy (sensor_msgs/Joy): a phone's, from phone_drive; see ``teleop.handover``.
Publishes, at 50 Hz (mode and scale_button: 10 Hz) and at once when they or the deadman change:
    /teleop_logi/human_in_loop (std_msgs/Bool): true while a deadman button is held and the gamepad is fresh; a button
        that is held at the start counts after all were released.
    /teleop_logi/tele_steer_req (std_msgs/Float32): −1 right .. +1 left; never exactly neutral while the human steers,
        where the planner would steer then; neutral under a deadman that gives the steering to the planner, unless the
        stick overrides it.
    /teleop_logi/tele_throt_req (std_msgs/Float32): −1 .. +1; 0 where the planner drives, unless the stick overrides it;
        NaN, which is a stop, where the human drives and the gamepad has no throttle axis that counts.
    /teleop_logi/mode (std_msgs/String): who steers and who drives, by the deadman that is held; see
        ``common.causes``.
    /teleop_logi/scale_button (std_msgs/Int8): 1 or −1 while the button for more or less speed by hand is pressed.
    ~state (TeleopState, latched): whether a human holds a deadman, cause, reason, what becomes of each stick, age of
        joy; when one of these changes and 10 times a second. For people: nothing that drives follows it.
    /diagnostics: the same with the remedy, and who else publishes on its topic; 1 Hz.
"""
from __future__ import annotations

from collections import Counter

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Float32, Int8, String

from car_interface.common import causes
from car_interface.common.causes import HUMAN_DRIVES
from car_interface.common.declared import read_all
from car_interface.common.errors import ConfigError
from car_interface.common.params import CONFIG_FOLDER
from car_interface.common.rate_timer import RateTimer
from car_interface.common.staleness import STARTED
from car_interface.msg import TeleopState
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import ERROR, OK, WARN, Diagnostics, age_text
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.teleop.gamepad import REPLACED, REPORT, Gamepad, GamepadConfig, RequestsLogFilter, remedy
from car_interface.teleop.handover import PHONE_TOPIC, Handover
from car_interface.teleop.mappings import config_for, load_entries, model_of

RATE_HZ = 50
TICKS_PER_STATE = 5


class TeleopLogi:
    def __init__(self, params, inbox):
        self._config = read_all(params, GamepadConfig)
        self._entries = load_entries(params.path(CONFIG_FOLDER, None))
        self._model = None  # of the newest message's gamepad
        self._handover = Handover(self._config)
        self._inbox = inbox
        self._published = None
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._log_filter = RequestsLogFilter()
        self._losses = Counter()  # by cause
        self._topic = inbox.resolve_name("joy")
        self._phone_remedy = f"See whether phone_drive runs: rostopic hz {inbox.resolve_name(PHONE_TOPIC)}"
        self._command_topics = CommandTopics(inbox)
        self._human = advertise("/teleop_logi/human_in_loop", Bool, inbox)
        self._steering = advertise("/teleop_logi/tele_steer_req", Float32, inbox)
        self._throttle = advertise("/teleop_logi/tele_throt_req", Float32, inbox)
        self._modes = advertise("/teleop_logi/mode", String, inbox)
        self._scale_buttons = advertise("/teleop_logi/scale_button", Int8, inbox)
        self._scale_button = 0
        self._states = advertise("~state", TeleopState, inbox, latch=True)
        self._diagnostics = Diagnostics(inbox, "none", {REPORT: self._report, **self._command_topics.reports},
                                        now_ns)
        inbox.on_overflow(lambda now_ns: self._handover.mark_stale())
        subscribe("joy", Joy, inbox, self._on_joy)
        subscribe(PHONE_TOPIC, Joy, inbox,
                  lambda message, now_ns: self._handover.phone.update(message.axes, message.buttons, now_ns))
        self._command_topics.start(self._diagnostics.report_now)

    def step(self, now_ns):
        """Handle each message; then the timer."""
        for handler, message, arrival_ns in self._inbox.drain():
            self._publish_if_changed(arrival_ns)  # a silence that this message ends, however short it was
            handler(message, arrival_ns)
            self._publish_if_changed(arrival_ns)
            self._publish_scale_button(arrival_ns)
        if self._timer.is_due(now_ns):
            self._tick(now_ns)
        self._diagnostics.step(now_ns)
        return self._timer.due_ns

    def shut_down(self):
        self._human.publish(False)

    def _on_joy(self, message, now_ns):
        model = model_of(message.header.frame_id, len(message.axes), len(message.buttons))
        if model != self._model:
            self._handover.gamepad = self._other_gamepad(model, STARTED if self._model is None else REPLACED)
            self._model = model
        self._handover.gamepad.update(message.axes, message.buttons, now_ns)

    def _other_gamepad(self, model, rearm_reason):
        try:
            return Gamepad(config_for(model, self._config, self._entries), rearm_reason)
        except ConfigError as error:
            return Gamepad(self._config, rearm_reason, str(error))

    def _tick(self, now_ns):
        requests = self._handover.requests(now_ns)
        self._publish(requests, now_ns)
        repeats = self._timer.ticks % TICKS_PER_STATE == 0
        self._publish_scale_button(now_ns, repeats)
        if repeats:
            self._modes.publish(requests.mode)
            self._publish_state(requests, now_ns)

    def _publish_if_changed(self, now_ns):
        requests = self._handover.requests(now_ns)
        before = self._published
        # A gamepad's sticks wait for the timer. A phone's delay is long enough without that.
        has_moved = self._handover.phone_is_current and before is not None and requests[:3] != before[:3]
        if before is None or has_moved or requests.differs_by != before.differs_by:
            self._publish(requests, now_ns)

    def _publish(self, requests, now_ns):
        """Publish the requests, and the state when it is of another kind than before."""
        before, self._published = self._published, requests
        # A release is sent first; requests are sent before a true, or the planner would steer in between.
        if not requests.human_in_loop:
            self._human.publish(False)
        # The mode is sent before the stick of a human who takes over, and after that of one who hands over: neither
        # must look like an override in between.
        is_new_mode = before is None or requests.mode != before.mode
        if is_new_mode and requests.mode in HUMAN_DRIVES:
            self._modes.publish(requests.mode)
        self._steering.publish(requests.steering)
        self._throttle.publish(requests.throttle)
        if is_new_mode and requests.mode not in HUMAN_DRIVES:
            self._modes.publish(requests.mode)
        if requests.human_in_loop:
            self._human.publish(True)
        if before is None or before.kind != requests.kind:
            self._publish_state(requests, now_ns)
        if before is None or before.cause != requests.cause:
            self._losses.update({requests.cause} & causes.LOSSES)
        if self._log_filter.is_new(requests, now_ns):
            self._log(requests)

    def _publish_scale_button(self, now_ns, repeats=False):
        before, self._scale_button = self._scale_button, self._handover.scale_button(now_ns)
        if repeats or self._scale_button != before:
            self._scale_buttons.publish(self._scale_button)

    def _publish_state(self, requests, now_ns):
        self._states.publish(TeleopState(
            stamp=self._clocks.ros_now(), human_in_loop=requests.human_in_loop,
            cause=requests.cause, reason=requests.reason,
            steering_stick=requests.steering_stick, throttle_stick=requests.throttle_stick,
            joy_age=self._handover.gamepad.joy.age_s(now_ns)))

    def _log(self, requests):
        is_loss = requests.cause in causes.LOSSES
        advice = self._advice(requests) if is_loss or requests.stick_cause else ""
        log = rospy.logwarn if is_loss or requests.stick_cause else rospy.loginfo
        log("human in loop: %s (%s)%s", requests.human_in_loop, requests.reason, advice and f". {advice}")

    def _advice(self, requests):
        if self._handover.phone_is_current:
            return self._phone_remedy if requests.cause == causes.JOY_STALE else ""
        return remedy(requests.cause, self._topic) or remedy(requests.stick_cause, self._topic)

    def _report(self, status):
        """Report cause, remedy and what the gamepad sends."""
        now_ns = self._clocks.now_ns()
        requests = self._handover.requests(now_ns)
        advice = self._advice(requests)
        status.summary(_level(requests), requests.reason + (advice and f". {advice}"))
        status.add("cause", requests.cause)
        status.add("human in loop", requests.human_in_loop)
        status.add("steering stick", requests.steering_stick or "as the mode says")
        status.add("throttle stick", requests.throttle_stick or "as the mode says")
        status.add("age of joy", age_text(self._handover.gamepad.joy.age_s(now_ns)))
        if self._handover.phone.joy.was_received:
            status.add("age of phone/joy", age_text(self._handover.phone.joy.age_s(now_ns)))
        status.add("gamepad", self._model or "its messages name none")
        status.add("axes, buttons", f"{self._handover.gamepad.axes}, {self._handover.gamepad.buttons}")
        for cause, count in sorted(self._losses.items()):
            status.add(f"times {cause}", count)


def _level(requests):
    """Return how bad a cause is: an error needs more than to let go of the deadman and to hold it again."""
    cause = requests.cause
    if cause in causes.JOY_UNUSABLE:
        return ERROR
    is_odd = cause in causes.LOSSES or cause == causes.JOY_NEVER_RECEIVED or requests.stick_cause
    return WARN if is_odd else OK


def main():
    run("teleop_logi", TeleopLogi)
