"""The phone_drive node: phones drive the car, watch it, and stop it.

What phones may do is decided by ``teleop.phone``; what of it counts beside a gamepad, by teleop_logi.

Publishes:
    phone/joy (sensor_msgs/Joy): what the driver's phone asks for, by the indices of ``teleop.handover``; on a change,
        when it is lost, and 20 times a second. Nothing is held unless his touch counts.
    phone/e_stop (std_msgs/Bool, latched): true = stop, until the driver clears it; on a change and 10 times a second.
    calibration_drive/finish (std_msgs/Empty): as the driver asks for it.
    /diagnostics: how many pages there are, and what was refused; 1 Hz.
Subscribes:
    The states of the nodes, sonar/* and /diagnostics, for the pages: see ``car_state``.
Calls, for the driver: turn_arb/set_parameters and ~save, throttle_arb/servo/set_parameters and ~save.
Starts, for the driver: rosbag record, bag_report, calibration_drive.
"""
from __future__ import annotations

import secrets
import sys
from contextlib import suppress
from functools import partial

from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerRequest

from car_interface.common.black_box_folder import default_folder
from car_interface.common.declared import read_all
from car_interface.common.errors import CarInterfaceError
from car_interface.common.units import NS_PER_S
from car_interface.nodes.phone_drive.car_state import CarState
from car_interface.nodes.phone_drive.config import AUTO, PhoneDriveConfig, announce, own_addresses
from car_interface.nodes.phone_drive.programs import CalibrationProgram, Recordings
from car_interface.ros.diagnostics import OK, Diagnostics
from car_interface.ros.reconfigure import request_values
from car_interface.ros.runtime import run
from car_interface.ros.topics import advertise
from car_interface.teleop.handover import PHONE_TOPIC
from car_interface.teleop.keyboard import Controls
from car_interface.teleop.phone import Phones
from car_interface.teleop.phone_messages import BEGIN, FINISH, GIVE_UP

TICKS_PER_E_STOP = 2  # of the rules', 20 a second
TICKS_PER_STATE = 4
TICKS_PER_LISTING = 40  # of the recordings' folder
CALL_NS = 10 * NS_PER_S  # a change or a save that isn't answered by then isn't waited for


class PhoneDrive:
    """Passes what phones send to the rules, publishes what these grant, and does what the driver asks for.

    Args:
        make_server: as ``server.Server``.
        make_recordings, make_calibration: as ``Recordings`` and ``CalibrationProgram``.
    """

    # A page's messages count by the age of the token that they echo, however long this node stood still.
    notices_standstill = True

    def __init__(self, params, inbox, make_server, make_recordings=Recordings, make_calibration=CalibrationProgram):
        config = read_all(params, PhoneDriveConfig)
        self._inbox = inbox
        now_ns = inbox.clocks.now_ns()
        pin = f"{secrets.randbelow(10 ** 6):06d}" if config.pin == AUTO else str(config.pin)
        self._phones = Phones(pin, now_ns, config.watch_without_pin, config.e_stop)
        self._stored_e_stop: bool | None = config.e_stop  # None: it is just being stored
        self._calls = 0  # that were begun and not answered
        self._called_ns = now_ns
        self._published = None  # controls and e-stop
        self._joy = advertise(PHONE_TOPIC, Joy, inbox)
        self._e_stop = advertise("phone/e_stop", Bool, inbox, latch=True)
        self._diagnostics = Diagnostics(inbox, "none", {"phones": self._report}, now_ns)
        inbox.on_overflow(lambda now_ns: self._phones.mark_stale())
        self._car = CarState(inbox)
        self._recordings = make_recordings(config.folder or default_folder("recordings"), inbox)
        self._calibration = make_calibration(inbox)
        self._server = make_server(config, inbox, self._phones)
        # Not to the log, which any node of the network receives.
        print(*announce(config, pin, own_addresses(), sys.stdout.isatty()), sep="\n", flush=True)

    def step(self, now_ns):
        """Handle what arrived; then what is due."""
        for handler, item, arrival_ns in self._inbox.drain():
            handler(item, arrival_ns)
            # By now, and not by the arrival: a touch that got too old while this node stood still must not count.
            self._publish_if_changed(now_ns)
        tick = self._phones.step(now_ns)
        self._publish_if_changed(now_ns)
        if tick:
            self._tick(tick, now_ns)
        for connection, message in self._phones.take_commands():
            self._execute(connection, message, now_ns)
        for outgoing in self._phones.drain():
            self._server.send(outgoing)
        self._diagnostics.step(now_ns)
        return self._phones.due_ns

    def shut_down(self):
        """Release the deadman; close what was begun."""
        self._publish_joy(Controls())
        self._server.stop()
        self._calibration.close()
        self._recordings.close()

    def _tick(self, tick, now_ns):
        self._publish_joy(self._published[0])
        if tick % TICKS_PER_E_STOP == 0:
            self._e_stop.publish(self._published[1])
        if tick % TICKS_PER_STATE == 0:
            self._store_e_stop()
            self._recordings.step()
            calibration = self._calibration.step(now_ns)
            if self._phones.pages:
                self._phones.show({**self._car.groups(now_ns), "recording": self._recordings.state(now_ns),
                                   "calibration": calibration})
        if tick % TICKS_PER_LISTING == 1:
            self._phones.show({"recordings": self._recordings.files()})

    # --- what counts ---

    def _publish_if_changed(self, now_ns):
        before = self._published or (None, None)
        self._published = controls, e_stop = self._phones.controls(now_ns), self._phones.e_stop
        if e_stop != before[1]:
            self._e_stop.publish(e_stop)
            self._store_e_stop()
        if controls != before[0]:
            self._publish_joy(controls)

    def _store_e_stop(self):
        """Keep the e-stop on the parameter server: this node's successor begins with it."""
        wanted = self._phones.e_stop
        if self._stored_e_stop in (wanted, None):
            return
        self._stored_e_stop = None

        def store():
            with suppress(OSError):  # the master doesn't answer: it is tried again
                self._inbox.graph.set_parameter(self._inbox.own_name("~e_stop"), wanted)
                return wanted
            return not wanted
        self._inbox.work(store, self._on_stored)

    def _on_stored(self, stored, now_ns):
        self._stored_e_stop = stored

    def _publish_joy(self, controls):
        message = Joy(axes=[controls.steering, controls.throttle],
                      buttons=[controls.manual, controls.autonomous, controls.scale == 1, controls.scale == -1])
        message.header.stamp = self._inbox.clocks.ros_now()
        self._joy.publish(message)

    # --- what the driver asks for ---

    def _execute(self, connection, message, now_ns):
        try:
            answer = getattr(self, f"_do_{message['type']}")(connection, message, now_ns)
        except CarInterfaceError as error:
            answer = {"refused": str(error)}
        if answer:
            self._phones.answer(connection, **answer)

    def _do_record(self, connection, message, now_ns):
        return {"done": self._recordings.begin(now_ns) if message["on"] else self._recordings.end()}

    def _do_calibrate(self, connection, message, now_ns):
        actions = {BEGIN: self._calibration.begin, FINISH: self._calibration.finish, GIVE_UP: self._calibration.give_up}
        return {"done": actions[message["what"]]()}

    def _do_open(self, connection, message, now_ns):
        path = self._recordings.path_of(message["name"])
        return {"refused": "there is no such file"} if path is None else {"file": self._server.offer(path)}

    def _do_trim(self, connection, message, now_ns):
        self._calibration.check_tuning()
        _, tuned, name = self._car.tuned[message["name"]]
        self._begin_call(1, now_ns)

        def on_done(accepted, problem):
            self._inbox.put(self._on_answer, (connection, {"refused": problem} if accepted is None else {
                "done": f"{message['name']} is {accepted.get(name)} now"}))
        request_values(self._inbox, tuned.namespace, {name: message["value"]}, on_done)

    def _do_save(self, connection, message, now_ns):
        self._calibration.check_saving()
        nodes = [node for node, tuned, _ in self._car.tuned.values() if tuned.values]
        if not nodes:
            raise CarInterfaceError("no node has anything to save")
        self._begin_call(len(nodes), now_ns)
        for node in nodes:
            def on_done(answer, problem, node=node):
                text = problem if answer is None else answer.message
                self._inbox.put(self._on_answer, (connection, {
                    "done" if answer is not None and answer.success else "refused": f"{node}: {text}"}))
            self._inbox.graph.call(self._inbox.resolve_name(f"{node}/save"), Trigger, TriggerRequest(), on_done)

    def _begin_call(self, count, now_ns):
        if self._calls and now_ns - self._called_ns < CALL_NS:
            raise CarInterfaceError("the last change has no answer yet")
        self._calls, self._called_ns = count, now_ns

    def _on_answer(self, answer, now_ns):
        connection, fields = answer
        self._calls = max(0, self._calls - 1)
        self._phones.answer(connection, **fields)

    def _report(self, status):
        status.summary(OK, "the e-stop is on" if self._phones.e_stop else "phones are served")
        status.add("pages", self._phones.pages)
        for what, count in sorted(self._phones.counts.items()):
            status.add(f"times {what}", count)


def main():
    from car_interface.nodes.phone_drive.server import Server  # here: nothing else of the package needs tornado
    run("phone_drive", partial(PhoneDrive, make_server=Server))
