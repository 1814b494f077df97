"""The pca9685 node: duties from ROS to the servo board, and each channel to its timeout value when they stop coming.

Subscribes:
    command, /servo/cmdVector (std_msgs/Int32MultiArray): 16 duties 0..65535 of the PWM period, −1 = leave it alone.
Publishes:
    /servo/output (std_msgs/Int32MultiArray, latched): the duties that the chip holds, −1 = never set; on change and
        at 1 Hz.
Parameters:
    ~device /dev/i2c-1: the bus, by path or number; ``virtual`` = a chip in software.
    ~address 0x40.  ~frequency 50 (Hz).  ~oscillator_hz 25e6.  ~prescale: overrides what these two make.
    ~timeout 250 (ms, 0 = never), ~timeout_value 0 (duty, 0 = off), ~pwm_min 0, ~pwm_max 65535: a list of 16, or one
        for all.
    ~required false: true = end with exit code 1 when the board can't be used at start.
"""
from __future__ import annotations

import errno
import math
import os
import time

import rospy
import smbus2
from std_msgs.msg import Int32MultiArray

from car_interface.errors import DeviceError
from car_interface.nodes.messages import duty_vector
from car_interface.nodes.node import NS_PER_S, Complaints, Heartbeat, run, subscribe
from car_interface.pca9685.board import Board
from car_interface.pca9685.channels import ChannelConfig, Channels, differences
from car_interface.pca9685.duty import PRESCALE_MAX, PRESCALE_MIN, duty_of_counts, frequency_for, prescale_for
from car_interface.servo import CHANNELS, MAX_DUTY, UNCHANGED
from car_interface.sim.pca9685_chip import VirtualBus, VirtualPca9685

OUTPUT_RATE_HZ = 1
FIRST_RETRY_NS, LAST_RETRY_NS = NS_PER_S // 10, 2 * NS_PER_S
LONGEST_TIMEOUT_MS = 3_600_000
VIRTUAL = "virtual"


def read_channels(params):
    """The sixteen channels' configuration."""
    timeouts_ms = params.integers("timeout", CHANNELS, 250, 0, LONGEST_TIMEOUT_MS)
    timeout_values = params.integers("timeout_value", CHANNELS, 0, 0, MAX_DUTY)
    pwm_min = params.integers("pwm_min", CHANNELS, 0, 0, MAX_DUTY)
    pwm_max = params.integers("pwm_max", CHANNELS, MAX_DUTY, 0, MAX_DUTY)
    return Channels([ChannelConfig(*settings) for settings in zip(timeouts_ms, timeout_values, pwm_min, pwm_max)])


def read_device(params):
    """The bus: ``virtual``, or a path (a number n means /dev/i2c-n)."""
    device = params.text_or_integer("device", "/dev/i2c-1")
    return f"/dev/i2c-{device}" if isinstance(device, int) else device


class Pca9685:
    """Takes commands, keeps the chip at what they say, and keeps trying when the chip fails."""

    def __init__(self, params, inbox):
        self._channels = read_channels(params)
        self._device = read_device(params)
        self._address = params.integer("address", 0x40, low=0x40, high=0x7F)
        frequency_hz = params.number("frequency", 50.0, above=0.0)
        self._oscillator_hz = params.number("oscillator_hz", 25e6, low=1e6, high=50e6)
        prescale = params.integer("prescale", None, low=PRESCALE_MIN, high=PRESCALE_MAX)
        self._prescale = prescale_for(frequency_hz, self._oscillator_hz) if prescale is None else prescale
        required = params.flag("required", False)
        params.finish()
        self._inbox = inbox
        self._complaints = Complaints()
        self._virtual_bus = VirtualBus({self._address: VirtualPca9685()}) if self._device == VIRTUAL else None
        self._bus = None
        self._board = None
        self._retry_ns = FIRST_RETRY_NS
        self._next_try_ns = 0
        self._heartbeat = Heartbeat(OUTPUT_RATE_HZ, time.monotonic_ns())
        self._published = [UNCHANGED] * CHANNELS
        self._outputs = rospy.Publisher("/servo/output", Int32MultiArray, queue_size=10, latch=True)
        if required:
            self._open()
        for topic in ("command", "/servo/cmdVector"):
            subscribe(topic, Int32MultiArray, inbox, self._on_command)

    def step(self, now_ns):
        """Take the commands that arrived, expire the old ones, and bring the chip to what is left."""
        for handler, message, arrival_ns in self._inbox.take():
            handler(message, arrival_ns)
            self._update()
        expired = self._channels.expire(now_ns)
        if expired:
            self._complaints.warn("timeout", f"no command for {_listed(expired)}: now at timeout value")
        if self._board is None and now_ns >= self._next_try_ns:
            self._try_open()
        self._update()
        self._publish(self._heartbeat.is_due(now_ns))
        return min(self._heartbeat.due_ns, self._channels.next_deadline_ns(),
                   self._next_try_ns if self._board is None else math.inf)

    def shut_down(self):
        """Timeout values for a whole period, then every output off: an ESC sees neutral before it sees nothing."""
        if self._board is None:
            return
        self._channels.make_safe()
        self._update()
        self._publish()
        if self._board is not None:
            time.sleep(2 * self._board.period_s)
            try:
                self._board.all_off()
            except OSError as error:
                self._lose(error)
        self._publish()
        time.sleep(0.02)  # the last output leaves by a thread of rospy's

    def _on_command(self, message, now_ns):
        try:
            accepted = self._channels.command(message.data, now_ns)
        except ValueError as error:
            self._complaints.warn("length", f"{error}: refused")
            return
        if accepted.refused:
            self._complaints.warn("refused", f"{_listed(accepted.refused)}: {message.data[accepted.refused[0]]} is no "
                                             f"duty and was refused; accepted: 0 to {MAX_DUTY}, {UNCHANGED}")
        if accepted.clamped:
            self._complaints.warn("clamped", f"{_listed(accepted.clamped)}: beyond pwm_min or pwm_max, clamped")

    def _update(self):
        """Write what differs, with one immediate retry; a chip that fails twice is reopened."""
        if self._board is None:
            return
        changes = differences(self._board.held, self._channels.targets)
        if not changes:
            return
        try:
            try:
                self._board.write(changes)
            except OSError as error:
                self._complaints.warn("retry", f"{self._name()}: {error}; tried again")
                self._board.write(differences(self._board.held, self._channels.targets))
        except OSError as error:
            self._lose(error)
        self._publish()

    def _try_open(self):
        try:
            self._open()
        except DeviceError as error:
            self._complaints.warn("absent", f"{error}. Trying again")
            self._next_try_ns = time.monotonic_ns() + self._retry_ns
            self._retry_ns = min(2 * self._retry_ns, LAST_RETRY_NS)
        else:
            self._retry_ns = FIRST_RETRY_NS

    def _open(self):
        """Open bus and chip, and give every channel its target."""
        try:
            self._open_bus()
            board = Board(self._bus, self._address, self._prescale, self._oscillator_hz, time.sleep)
            board.initialise()
            board.write(differences(board.held, self._channels.targets))
        except OSError as error:
            self._close_bus()
            raise DeviceError(self._name(), *_explain(self._device, self._address, error)) from error
        self._board = board
        rospy.loginfo("%s: running at %.2f Hz (prescale %d)", self._name(),
                      frequency_for(self._prescale, self._oscillator_hz), self._prescale)

    def _lose(self, error):
        cause, cure = _explain(self._device, self._address, error)
        self._complaints.warn("lost", f"{self._name()} was lost: {cause}. {cure}. Opening it again")
        self._close_bus()
        self._board = None
        self._next_try_ns = time.monotonic_ns() + self._retry_ns

    def _open_bus(self):
        if self._virtual_bus is not None:
            self._bus = self._virtual_bus
            return
        self._bus = smbus2.SMBus()  # in two steps: what is no I2C bus fails after it was opened
        self._bus.open(self._device)

    def _close_bus(self):
        if self._bus is not None and self._bus is not self._virtual_bus:
            self._bus.close()
        self._bus = None

    def _publish(self, always=False):
        duties = self._published  # of a chip that was lost: what it held last, for it goes on pulsing
        if self._board is not None:
            duties = [UNCHANGED if counts is None else duty_of_counts(counts) for counts in self._board.held]
        if always or duties != self._published:
            self._published = duties
            self._outputs.publish(duty_vector(duties))

    def _name(self):
        return f"PCA9685 at 0x{self._address:02x} on {self._device}"


def _listed(channels):
    return ("channel " if len(channels) == 1 else "channels ") + ", ".join(map(str, channels))


def _explain(device, address, error):
    """Cause and cure of a failed transfer or open."""
    bus = device.rsplit("-", 1)[-1]
    if not os.path.exists(device) and device != VIRTUAL:
        return "there is no such bus", "Switch I2C on (sudo raspi-config) and see which buses there are: ls /dev/i2c-*"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "no permission to use the bus", "Join its group and log in anew: sudo usermod -aG i2c $USER"
    if error.errno in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        return "this is not an I2C bus", "Set ~device to one of: ls /dev/i2c-*"
    if error.errno in (errno.EREMOTEIO, errno.ENXIO, errno.EIO, errno.ETIMEDOUT):
        return (f"nothing answers at this address ({error.strerror})",
                f"Check power, SDA and SCL, and see what is on the bus: i2cdetect -y {bus}")
    if error.errno == errno.EBUSY:
        return "a kernel driver has this address", "Unbind it, or set ~address to the board's own"
    return f"the bus failed ({error})", f"See what is on the bus: i2cdetect -y {bus}"


def main():
    """Run the node."""
    run("pca9685", Pca9685)
