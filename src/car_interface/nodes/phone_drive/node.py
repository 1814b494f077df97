"""The phone_drive node: phones drive the car, watch it, and stop it.

What phones may do is decided by ``teleop.phone``; what of it counts beside a gamepad, by teleop_logi.

Publishes:
    phone/joy (sensor_msgs/Joy): what the driver's phone asks for, by the indices of ``teleop.handover``; on a change,
        when it is lost, and 20 times a second. Nothing is held unless his touch counts.
    phone/e_stop (std_msgs/Bool, latched): true = stop, until the driver clears it; on a change and 10 times a second.
    /diagnostics: how many pages there are, and what was refused; 1 Hz.
Subscribes:
    turn_arb/state (SteeringState), throttle_arb/state (ThrottleState), teleop_logi/state (TeleopState): shown on the
        pages.
"""
from __future__ import annotations

import secrets
from functools import partial

from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from car_interface.common.declared import read_all
from car_interface.common.rate_timer import RateTimer
from car_interface.msg import SteeringState, TeleopState, ThrottleState
from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.ros.diagnostics import OK, Diagnostics
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise, subscribe
from car_interface.teleop.handover import PHONE_TOPIC
from car_interface.teleop.keyboard import Controls
from car_interface.teleop.phone import Phones

RATE_HZ = 20
TICKS_PER_E_STOP = 2
SHOWN = {"turn_arb": SteeringState, "throttle_arb": ThrottleState, "teleop_logi": TeleopState}


class PhoneDrive:
    """Passes what phones send to the rules, and publishes what these grant.

    Args:
        params: the node's parameters.
        inbox: the node's.
        make_server: called with configuration and inbox; see ``server.Server``. Of each connection it puts into the
            inbox, for ``on_connect``, ``on_message`` and ``on_disconnect``, what happens.
        make_pin: returns six digits.
    """

    # A page's messages count by the age of the token that they echo, however long this node stood still.
    notices_standstill = True

    def __init__(self, params, inbox, make_server, make_pin=lambda: f"{secrets.randbelow(10 ** 6):06d}"):
        config = read_all(params, PhoneDriveConfig)
        self._inbox = inbox
        now_ns = inbox.clocks.now_ns()
        pin = make_pin()
        self._phones = Phones(pin, now_ns)
        self._timer = RateTimer(RATE_HZ, now_ns)
        self._ticks = 0
        self._published = None  # controls and e-stop
        self._joy = advertise(PHONE_TOPIC, Joy, inbox)
        self._e_stop = advertise("phone/e_stop", Bool, inbox, latch=True)
        self._diagnostics = Diagnostics(inbox, "none", {"phones": self._report}, now_ns)
        inbox.on_overflow(lambda now_ns: self._phones.mark_stale())
        for name, message_type in SHOWN.items():
            subscribe(f"{name}/state", message_type, inbox,
                      lambda message, now_ns, name=name: self._phones.show(
                          name, {"cause": message.cause, "text": message.reason}), wakes=False)
        self._server = make_server(config, inbox, self)
        print(f"The PIN for phones is {pin}", flush=True)  # not to the log, which any node of the network receives

    def step(self, now_ns):
        """Handle what arrived; then what is due."""
        for handler, item, arrival_ns in self._inbox.drain():
            handler(item, arrival_ns)
            # By now, and not by the arrival: a touch that got too old while this node stood still must not count.
            self._publish_if_changed(now_ns)
        self._phones.step(now_ns)
        self._publish_if_changed(now_ns)
        if self._timer.is_due(now_ns):
            self._ticks += 1
            self._publish_joy(self._published[0])
            if self._ticks % TICKS_PER_E_STOP == 0:
                self._e_stop.publish(self._published[1])
        for outgoing in self._phones.drain():
            self._server.send(outgoing)
        self._diagnostics.step(now_ns)
        return min(self._timer.due_ns, self._phones.due_ns)

    def shut_down(self):
        """Release the deadman."""
        self._publish_joy(Controls())
        self._server.stop()

    def on_connect(self, connection, now_ns):
        """Take (number, address) of a connection."""
        self._phones.connect(*connection, now_ns)

    def on_message(self, message, now_ns):
        """Take (number, data) of a message."""
        self._phones.receive(*message, now_ns)

    def on_disconnect(self, number, now_ns):
        """Take note that a connection is gone."""
        self._phones.disconnect(number)

    def _publish_if_changed(self, now_ns):
        before = self._published or (None, None)
        self._published = controls, e_stop = self._phones.controls(now_ns), self._phones.e_stop
        if e_stop != before[1]:
            self._e_stop.publish(e_stop)
        if controls != before[0]:
            self._publish_joy(controls)

    def _publish_joy(self, controls):
        message = Joy(axes=[controls.steering, controls.throttle],
                      buttons=[controls.manual, controls.autonomous, controls.scale == 1, controls.scale == -1])
        message.header.stamp = self._inbox.clocks.ros_now()
        self._joy.publish(message)

    def _report(self, status):
        """How many pages there are, and what was refused, for /diagnostics."""
        status.summary(OK, "the e-stop is on" if self._phones.e_stop else "phones are served")
        status.add("pages", self._phones.pages)
        for what, count in sorted(self._phones.counts.items()):
            status.add(f"times {what}", count)
        return status


def main():
    """Run the node."""
    from car_interface.nodes.phone_drive.server import Server  # here: nothing else of the package needs tornado
    run("phone_drive", partial(PhoneDrive, make_server=Server))
