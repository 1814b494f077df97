"""What turn_arb and throttle_arb do alike: they command one channel of the servo board, and say why.

They decide at a rate, and at once on a change. A new decision's command goes out first, then its state; a line about it
follows in the log.
"""
from __future__ import annotations

import math

import rospy
from std_msgs.msg import Int32MultiArray

from car_interface.common import causes
from car_interface.common.rate_timer import RateTimer
from car_interface.common.sources import source_name
from car_interface.ros.clocks import StampedAge
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import Diagnostics
from car_interface.ros.inbox import Inbox
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.topics import advertise, one_channel_duty, subscribe_interlock

TICKS_PER_STATE = 5  # at 100 and 50 Hz: generic_value_converter waits 0.25 s for a state
LOG_AFTER_NS = 20_000_000  # teleop_logi's state, which a line may quote, arrives after its human_in_loop


class CommandNode:
    """Publish decisions, which have a ``duty``, ``differs_by`` (what is published), and ``kind`` (what is logged).

    A subclass subscribes to its inputs, and has ``_decide_now``, ``_mark_stale``, ``_publish_state`` and ``_log``.
    It sets ``_reconfigure``, its live tuning, and ``_neutral``, what is published on servo/neutral.
    For ``find_unheard`` see ``CommandTopics``.
    """

    repeats_change = True  # a command that was published since the last tick is published at the next one, too

    def __init__(self, inbox: Inbox, rate_hz: int, channel: int, arbiter, state_type, reports: dict,
                 find_unheard=None):
        self._inbox, self._clocks = inbox, inbox.clocks
        self._rate_hz, self._channel = rate_hz, channel
        now_ns = self._clocks.now_ns()
        self._timer = RateTimer(rate_hz, now_ns)
        self._decision = None
        self._was_commanded = False  # since the last tick
        self._unlogged = []  # when its log line is due, the decision before, the decision
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._notices = ThrottledWarnings(inbox.clocks, rospy.loginfo)
        self._odometry_age = StampedAge("odometry", inbox.clocks)
        self._commands = advertise("/servo/cmdVector", Int32MultiArray, inbox)
        self._neutrals = advertise("servo/neutral", Int32MultiArray, inbox, latch=True)
        self._states = advertise("~state", state_type, inbox, latch=True)
        self._command_topics = CommandTopics(inbox, find_unheard=find_unheard)
        self._diagnostics = Diagnostics(inbox, "none", {**reports, **self._command_topics.reports}, now_ns)
        inbox.on_overflow(self._on_overflow)
        subscribe_interlock(inbox, arbiter, self._decide)

    def step(self, now_ns):
        """Handle what arrived; then the timer."""
        self._inbox.dispatch()
        if self._timer.is_due(now_ns):
            self._tick(now_ns)
        self._diagnostics.step(now_ns)
        return self._timer.due_ns

    def _on_overflow(self, now_ns):
        self._mark_stale(now_ns)
        self._decide(now_ns)

    def _decide(self, now_ns):
        """Publish at once when the decision has changed; return whether it has."""
        before, decision = self._decision, self._decide_now(now_ns)
        if before is not None and before.differs_by == decision.differs_by:
            return False
        self._decision = decision
        self._publish_command()
        self._publish_state(decision)
        if before is None or before.kind != decision.kind:
            self._unlogged.append((now_ns + LOG_AFTER_NS, before, decision))
        return True

    def _tick(self, now_ns):
        self._reconfigure.step(now_ns)
        if not self._decide(now_ns) and (self.repeats_change or not self._was_commanded):
            self._publish_command()
        self._was_commanded = False
        if self._timer.ticks % TICKS_PER_STATE == 0:
            self._publish_state(self._decide_now(now_ns))
        while self._unlogged and now_ns >= self._unlogged[0][0]:
            self._log(*self._unlogged.pop(0)[1:])
        if self._timer.ticks % self._rate_hz == 0:  # a topic latches one message in a process, also for two nodes in it
            self._neutrals.publish(self._neutral)

    def _check_request(self, who, name, value, cause, effect):
        """Warn of a request that isn't finite, for a cause and with an effect, or that is beyond −1..1."""
        if not math.isfinite(value):
            self._warnings.warn(cause, f"{name} is {value}: {effect}")
        elif abs(value) > 1:
            self._warnings.warn(f"{who} clamped", f"{name} is {value:.3f}: clamped to -1..1")

    @staticmethod
    def _log_source(decision, newest, is_alarming):
        """Log who commands, and why. Why no human holds the deadman may have become known since the decision."""
        reason = newest.reason if newest.cause == decision.cause == causes.HUMAN_ABSENT else decision.reason
        (rospy.logwarn if is_alarming else rospy.loginfo)("%s: %s", source_name(decision.source), reason)

    def _publish_command(self):
        self._commands.publish(one_channel_duty(self._channel, self._decision.duty))
        self._was_commanded = True
