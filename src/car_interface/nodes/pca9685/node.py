"""The pca9685 node: writes duties to the servo board, and a channel's timeout value when its commands stop.

Subscribes:
    command, /servo/cmdVector (std_msgs/Int32MultiArray): 16 duties 0..65535 of the PWM period, −1 = unchanged.
    servo/neutral (std_msgs/Int32MultiArray): 16 neutrals, −1 = none, which the timeout values follow.
Publishes:
    /servo/output (std_msgs/Int32MultiArray, latched): the duties in the chip, −1 = never set; on change and at
        10 Hz. While the guard acts alone ``nodes.pca9685.output_relay`` publishes it.
    /diagnostics: the board, its faults, which channels have timed out and how often each did; the guard; who publishes
        on its topics; 1 Hz, and when a channel times out.
The virtual chip has a service of its own: see ``nodes.pca9685.virtual_board``.
Arguments, by a launch file: --device, --address, --virtual-chip, which these parameters must agree with: see
    ``common.fixed_parameters``.
"""
from __future__ import annotations

import os
from collections import Counter
from contextlib import suppress
from typing import Callable

import rospy
import smbus2
from std_msgs.msg import Int32MultiArray

from car_interface.common.causes import FOREIGN_WRITE, NODE_STOOD_STILL
from car_interface.common.declared import read_all
from car_interface.common.devices import read_header
from car_interface.common.errors import DeviceError
from car_interface.common.file_lock import lock_byte
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import CHANNELS, MAX_DUTY, NS_PER_S, UNCHANGED
from car_interface.nodes.pca9685.guard_link import GuardChild, GuardLink
from car_interface.nodes.pca9685.virtual_board import VirtualBoardBus, chip_path
from car_interface.pca9685.board import Board
from car_interface.pca9685.bus import choose_bus, explain
from car_interface.pca9685.channels import Channels
from car_interface.pca9685.config import AUTO, VIRTUAL, Pca9685Config
from car_interface.pca9685.registers import duty_of_counts, frequency_for
from car_interface.pca9685.senders import ChannelSenders, listed
from car_interface.pca9685.supervisor import DISCONNECTED, FOREIGN, FOUND, MISMATCH, RETRIED, RUNNING, BoardSupervisor
from car_interface.ros.command_topics import CommandTopics
from car_interface.ros.diagnostics import ERROR, OK, Diagnostics
from car_interface.ros.logs import ThrottledWarnings
from car_interface.ros.runtime import is_respawned, run
from car_interface.ros.topics import advertise, duty_vector, sender_of, subscribe

OUTPUT_RATE_HZ = 10
SWITCH_OFF_TIMEOUT_S = 1.0  # how long a node that ends tries to switch the chip off
COMMANDS = ("command", "/servo/cmdVector")
NEUTRALS = "servo/neutral"


class SmbusBus:
    """A bus of the kernel, opened by smbus2. A lock on the address excludes a second pca9685 node.

    Args:
        find: returns the path, or raises BoardNotFound. It is called until it has found one, which stands then.

    Attributes:
        path: the bus's; empty until it is found.
        name: the path for messages.
    """

    kind = "i2c"

    def __init__(self, address: int, path: str = "", name: str = "", find: Callable[[], str] | None = None):
        self._address, self.path, self.name, self._find = address, path, path or name, find

    @property
    def exists(self) -> bool:
        """Return whether there is something at the path, as far as is known."""
        return not self.path or os.path.exists(self.path)

    def open(self) -> smbus2.SMBus:
        """Return the open bus.

        Raises:
            OSError: it can't be opened, another node has the lock; BoardNotFound: as ``find`` raises it.
        """
        if not self.path:
            self.path = self.name = self._find()
        bus = smbus2.SMBus()  # in two steps: a device that is no I2C bus fails after it was opened
        try:
            bus.open(self.path)
            # A node that ends must not switch off the chip of its successor.
            lock_byte(bus.fd, self._address)
        except OSError:
            bus.close()
            raise
        return bus


def make_bus(config, inbox):
    """Return the bus of the node's device, closed.

    Raises:
        ConfigError: path or log of a virtual one can't be used.
    """
    if config.device == VIRTUAL:
        path = config.virtual_chip or chip_path(inbox.node_name)
        return VirtualBoardBus(path, config.address, config.virtual_log, inbox)
    if config.device != AUTO:
        return SmbusBus(config.address, config.device)
    header = read_header()

    def find():
        path = choose_bus(header, config.address, smbus2.SMBus)
        if is_respawned():  # once restarted it takes this bus again, until the next launch clears the parameters
            with suppress(OSError):  # the master is gone
                inbox.graph.set_parameter(inbox.own_name("~auto_device"), path)
        return path
    return SmbusBus(config.address, name=" or ".join(header.bus_paths), find=find)


class Pca9685:
    """Passes commands to the chip, applies timeouts, and reports.

    Args:
        make_bus: another function where a test connects a chip.
        start_guard: another one where a test runs the guard; called as ``GuardChild``.
    """

    notices_standstill = True  # by its guard, which acts sooner than the other nodes' inputs time out

    def __init__(self, params, inbox, make_bus=make_bus, start_guard=GuardChild):
        config = read_all(params, Pca9685Config)
        self._clocks = inbox.clocks
        now_ns = self._clocks.now_ns()
        self._channels = Channels(config.channels)
        self._address, self._prescale, self._oscillator_hz = config.address, config.prescale, config.oscillator_hz
        self._frequency_hz = frequency_for(config.prescale, config.oscillator_hz)
        self._bus = bus = make_bus(config, inbox)
        self._header = read_header()
        self._inbox = inbox
        self._warnings = ThrottledWarnings(inbox.clocks)
        self._outputs = advertise("/servo/output", Int32MultiArray, inbox, latch=True)

        def guard():
            return start_guard(bus.kind, bus.path, self._address, config.guard_off_after_ns, inbox.node_name,
                               self._outputs.resolved_name)
        self._guard = GuardLink(guard if config.guard else None, config.guard_off_after_ns, self._name,
                                self._warnings, inbox.clocks)
        self._supervisor = BoardSupervisor(self._open_board, self._on_board_event)
        self._fault = None  # why the board can't be used, as (cause, remedy)
        self._dropped = 0  # commands that arrived meanwhile
        self._held_back = 0  # commands that arrived before the guard had left the chip to this node again
        self._timeouts: Counter = Counter()  # by channel
        self._timeout_reported_ns = now_ns - NS_PER_S  # when the last one was
        self._timer = RateTimer(OUTPUT_RATE_HZ, now_ns)
        self._published: list[int | None] = [None] * CHANNELS  # counts; None = unknown
        # Several nodes publish on each, but no two of them command the same channel.
        self._senders = ChannelSenders()
        self._command_topics = CommandTopics(inbox, (*COMMANDS, NEUTRALS), lambda now_ns, topics: [
            *self._timeout_faults(now_ns, topics), *self._senders.conflict_faults(now_ns, topics)])
        self._diagnostics = Diagnostics(inbox, self._name(), {
            "servo board": self._report,
            "guard": lambda status: self._guard.report(status, self._clocks.now_ns(), self._supervisor.running),
            **self._command_topics.reports}, now_ns)
        if config.required:
            try:
                self._supervisor.open(self._targets, now_ns)
            except OSError as error:
                raise DeviceError(self._name(), *self._explain(error)) from error
        inbox.on_overflow(self._channels.make_safe)
        for topic in COMMANDS:
            subscribe(topic, Int32MultiArray, inbox, self._on_command)
        subscribe(NEUTRALS, Int32MultiArray, inbox, self._on_neutral)
        self._command_topics.start(self._diagnostics.report_now)

    def step(self, now_ns):
        """Handle all that arrived, expire commands, and then write: a slow bus must not replay stale commands."""
        self._follow_guard(now_ns)
        self._inbox.dispatch()
        self._expire(self._clocks.now_ns())
        self._update()
        self._publish(self._timer.is_due(now_ns))
        self._diagnostics.step(now_ns)
        return min(self._timer.due_ns, self._diagnostics.due_ns, self._channels.next_deadline_ns(),
                   self._supervisor.next_due_ns(), self._guard.watch.due_ns)

    def _follow_guard(self, now_ns):
        """Give the guard its sign of life. After a standstill start over, and only then acknowledge."""
        self._guard.receive(now_ns)
        still_ns = self._guard.watch.stood_still_ns(now_ns)
        if self._guard.watch.was_overruled() or still_ns:
            self._begin_anew(still_ns)
        self._step_guard()

    def _step_guard(self):
        self._guard.step(self._clocks.now_ns(), self._channels.timeout_counts, self._supervisor.ever_ran,
                         can_start=bool(self._bus.path))

    def _open_board(self):
        was_known = self._bus.path
        bus = self._bus.open()
        if not was_known:
            self._step_guard()  # before anything is written to the chip
        return Board(bus, self._address, self._prescale, self._clocks.sleep)

    def _begin_anew(self, still_ns):
        """Go to the timeout values, and obey no command that was sent before."""
        self._inbox.begin_anew(self._clocks.now_ns(), still_ns)  # which makes the channels safe
        lasted = f" for {still_ns / NS_PER_S:.2f} s" if still_ns else ""
        self._warnings.warn(NODE_STOOD_STILL, f"{NODE_STOOD_STILL}{lasted}: {self._name()} is at its timeout values; "
                                              "commands count from now on")
        self._supervisor.read_back(self._clocks.now_ns())
        self._publish()  # what the guard wrote
        self._update()

    def _targets(self):
        """Return what the chip should hold now. The supervisor asks at each attempt to write."""
        now_ns = self._clocks.now_ns()
        if self._guard.watch.is_late(now_ns):
            self._channels.make_safe(now_ns)  # a transfer took so long that the guard acts
        self._expire(now_ns)
        return self._channels.targets

    def _expire(self, now_ns):
        expired = self._channels.expire(now_ns)
        if expired:
            self._timeouts.update(expired)
            if now_ns - self._timeout_reported_ns >= NS_PER_S:  # commands that are too slow expire many times a second
                self._timeout_reported_ns = now_ns
                self._diagnostics.report_now()
            self._warnings.warn(f"timeout of {expired}", f"no command for {listed(expired)}: now at timeout value")

    def shut_down(self):
        """Hold the timeout values for a whole period, then switch every output off: an ESC sees neutral before that."""
        is_safe = not self._supervisor.ever_ran
        try:
            if not is_safe:
                self._switch_off()
                is_safe = True
        finally:
            self._supervisor.close()
            self._guard.end(self._clocks.now_ns(), self._channels.timeout_counts, is_safe)

    def _switch_off(self):
        self._channels.make_safe(self._clocks.now_ns())
        self._retry(self._update_now)
        self._clocks.sleep(2 / self._frequency_hz)
        self._retry(lambda: self._update_now() and self._supervisor.all_off(self._clocks.now_ns()))
        self._publish()

    def _update_now(self):
        """Write the targets without waiting for the next attempt; return whether the chip has them."""
        self._supervisor.retry_now()
        self._update()
        return self._supervisor.running

    def _retry(self, action):
        """Repeat ``action``, which returns whether it succeeded, for up to a second."""
        def attempt():
            self._guard.leave_to_node(self._clocks.now_ns(), self._channels.timeout_counts)
            return action()
        if not self._clocks.wait_for(attempt, SWITCH_OFF_TIMEOUT_S, 0.02):
            raise DeviceError(self._name(), "it can't be switched off and goes on pulsing what it was last told",
                              "Cut its power" + self._guard.outlook())

    def _on_command(self, message, now_ns):
        if self._guard.watch.holds:
            self._held_back += 1
            return
        try:
            clamped, refused = self._channels.command(message.data, now_ns)
        except ValueError as error:
            self._warnings.warn("length", f"{error}: refused")
            return
        self._senders.update(sender_of(message), message.data, now_ns)
        self._dropped += not self._supervisor.running
        if refused:
            first = refused[0]
            self._warnings.warn("refused", f"{listed(refused)} refused: {message.data[first]} of channel {first} is no "
                                           f"duty; accepted: 0 to {MAX_DUTY}, {UNCHANGED}")
        if clamped:
            self._warnings.warn("clamped", f"{listed(clamped)}: beyond pwm_min or pwm_max, clamped")

    def _timeout_faults(self, now_ns, topics):
        return self._senders.timeout_faults(self._channels.timed_out(now_ns), now_ns, topics,
                                            self._inbox.graph.process_name())

    def _on_neutral(self, message, now_ns):
        """Let timeout values follow the neutrals of the nodes that command the channels."""
        try:
            changed, refused = self._channels.follow(message.data)
        except ValueError as error:
            self._warnings.warn("length of neutrals", f"{error}: refused")
            return
        for channel in refused:
            self._warnings.warn("neutral", f"channel {channel} rests at {message.data[channel]} by servo/neutral, "
                                             f"its timeout value is {self._channels.timeout_values[channel]}: too far "
                                             "to follow. Start both nodes with the same YAML file")
        if changed:
            self._warnings.warn("followed", f"the timeout value of {listed(sorted(changed))} follows servo/neutral, "
                                            "away from the YAML file's. To save it: ~save of the node that was tuned")

    def _update(self):
        self._supervisor.update(self._targets, self._clocks.now_ns())
        self._publish()

    def _explain(self, error):
        return explain(error, self._bus.name, self._bus.exists, self._header)

    def _on_board_event(self, event, error):
        """Log an event of bus or chip, with cause and remedy."""
        if event == FOUND:
            self._publish()
        elif event == RUNNING:
            self._fault = None
            self._guard.chip_is_reached(self._clocks.now_ns(), self._channels.timeout_counts)
            rospy.loginfo("%s: running at %.2f Hz (prescale %d)", self._name(), self._frequency_hz, self._prescale)
        elif event == RETRIED:
            self._warnings.warn(event, f"{self._name()}: {error}; tried again")
        elif event == FOREIGN:
            self._warnings.warn(event, f"{FOREIGN_WRITE} to {self._name()}: {error}. Written anew. See which other "
                                       "program writes to it")
        elif event == MISMATCH:
            self._warnings.warn(event, f"{self._name()} has forgotten what it was told ({error}): it lost its power, "
                                         "or another program writes to it. Initialising it anew")
        else:
            self._fault = self._explain(error)
            was = " was lost" if event == DISCONNECTED else ""
            self._warnings.warn(event, f"{self._name()}{was}: {'. '.join(self._fault)}. Trying again")

    def _report(self, status):
        """Report the board's state and counts."""
        if self._supervisor.running:
            status.summary(OK, f"running at {self._frequency_hz:.2f} Hz")
        else:
            status.summary(ERROR, ". ".join(self._fault or ("not opened yet", "")))
        faults = self._timeout_faults(self._clocks.now_ns(), self._command_topics.topics)
        for fault in faults:
            status.mergeSummary(ERROR, fault.reason)
        if faults:
            status.add("cause", faults[0].cause)
            status.add("remedy", ". ".join(fault.remedy for fault in faults))
        status.add("bus", self._bus.name)
        status.add("address", f"0x{self._address:02x}")
        status.add("period", f"{1e3 / self._frequency_hz:.3f} ms if the oscillator makes {self._oscillator_hz:.0f} Hz; "
                             "not measured")
        status.add("failed transfers", self._supervisor.errors)
        status.add("reopened", self._supervisor.reopenings)
        status.add("initialised anew after a loss of power", self._supervisor.reinitialisations)
        status.add("channels that another program wrote", self._supervisor.foreign_writes)
        status.add("commands dropped while it was away", self._dropped)
        status.add("commands dropped after this node stood still", self._held_back + self._inbox.old_messages)
        status.add("timeout values", " ".join(map(str, self._channels.timeout_values)))
        for channel, count in sorted(self._timeouts.items()):
            status.add(f"timeouts of channel {channel}", count)
        for kind in ("length", "refused", "clamped"):
            status.add(f"commands {kind}", self._warnings.counts[kind])

    def _publish(self, always=False):
        # A chip that is out of reach keeps its last pulses.
        held = self._supervisor.held if self._supervisor.running else self._published
        if always or held != self._published:
            self._published = held
            self._outputs.publish(duty_vector([UNCHANGED if counts is None else duty_of_counts(counts)
                                               for counts in held]))

    def _name(self):
        return f"PCA9685 at 0x{self._address:02x} on {self._bus.name}"


def main():
    run("pca9685", Pca9685)
