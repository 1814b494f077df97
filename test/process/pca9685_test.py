#!/usr/bin/env python3
"""pca9685 by its topics, on the chip in software: started by its launch file, and by itself with other parameters."""
from __future__ import annotations

import os
import select
import shlex
import shutil
import signal
import tempfile
import time
import unittest

import rospy
import rostest
from car_interface.srv import InjectFault
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Log
from std_msgs.msg import Int32MultiArray

from car_interface.sim.chip_link import ChipLink
from waiting import (
    PATIENCE_S,
    Repeater,
    Sender,
    Topic,
    eventually,
    executable,
    rate_hz,
    retried,
    start,
    start_node,
)

# As the README has it.
README_LINE = (
    "rostopic pub /command std_msgs/Int32MultiArray -r 10 \"{layout: {dim: [{label: '', size: 0, stride: 0}], "
    "data_offset: 0}, data: [5100, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]}\"")
CENTER_ON_CHIP = 5104  # 5100 / 16 = 318.75, so 319 counts
FAILSAFE = (CENTER_ON_CHIP,) + (0,) * 15  # the shipped timeout values
TIMEOUT_S = 0.25


def vector(first=(), length=16, rest=-1):
    """A command with its first duties, and ``rest`` for the other channels."""
    return Int32MultiArray(data=(list(first) + [rest] * length)[:length])


class Pca9685WithItsShippedConfig(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.outputs = Topic("/servo/output", Int32MultiArray).connected()
        cls.log = Topic("/rosout", Log).connected(2)
        cls.command = Sender("/command", Int32MultiArray)
        cls.cmd_vector = Sender("/servo/cmdVector", Int32MultiArray)

    def setUp(self):
        self.inputs = Repeater(period_s=0.02)
        self.addCleanup(self.inputs.end)
        self.wait_for_output(FAILSAFE)

    def wait_for_output(self, data, since=None):
        """The first output with this data; without ``since`` what the chip holds already counts."""
        held = self.outputs.mark() - 1 if since is None else since
        return self.outputs.wait_for(lambda output: output.data == tuple(data), max(held, 0))

    def wait_for_warning(self, text, since):
        self.log.wait_for(
            lambda entry: entry.name == "/pca9685" and entry.level == Log.WARN and text in entry.msg, since)

    def test_the_line_in_the_readme_works_as_typed(self):
        """On a second node with no parameter set, whose channel 0 is off unless a command sets it."""
        bare = start_node(self, "pca9685", "_device:=virtual", "/servo/output:=bare/output",
                          "/servo/cmdVector:=bare/cmdVector", name="bare")
        outputs = Topic("/bare/output", Int32MultiArray)
        self.addCleanup(outputs.close)
        outputs.wait_for(lambda output: output.data == (0,) * 16)
        typed = start(self, *shlex.split(README_LINE))
        outputs.wait_for(lambda output: output.data == (CENTER_ON_CHIP,) + (0,) * 15)
        typed.end()
        outputs.wait_for(lambda output: output.data == (0,) * 16, outputs.mark())
        self.assertEqual(bare.end(), 0)

    def test_output_has_the_layout_of_a_command_and_comes_ten_times_a_second(self):
        def attempt():
            self.assertAlmostEqual(rate_hz(self.outputs, over_s=1.0), 10, delta=1)
        retried(attempt)
        late = Topic("/servo/output", Int32MultiArray)
        self.addCleanup(late.close)
        output = late.wait_for(lambda _: True, within_s=0.5).what
        self.assertEqual(output._connection_header["latching"], "1")
        self.assertEqual([(dim.label, dim.size, dim.stride) for dim in output.layout.dim], [("pwm_channel", 16, 1)])
        self.assertEqual(output.data, FAILSAFE)

    def test_both_topics_set_channels_and_minus_one_leaves_them_alone(self):
        self.inputs.hold(self.command, vector([-1, -1, 1000, 65535]))
        self.wait_for_output((CENTER_ON_CHIP, 0, 1008, 65535) + (0,) * 12)
        self.inputs.hold(self.cmd_vector, vector([3800]))
        self.wait_for_output((3808, 0, 1008, 65535) + (0,) * 12)
        self.inputs.hold(self.cmd_vector, vector([6700, 7]))
        self.wait_for_output((6704, 0, 1008, 65535) + (0,) * 12)
        self.inputs.hold(self.cmd_vector, vector([6700, 8]))
        self.wait_for_output((6704, 16, 1008, 65535) + (0,) * 12)

    def test_15_and_17_elements_are_refused_as_a_whole(self):
        for length in (0, 15, 17, 1000):
            mark = self.outputs.mark()
            self.cmd_vector.publish(vector([4000], length, rest=3000))
            self.cmd_vector.publish(vector([-1, 500 + 16 * (length % 7)]))
            first = self.outputs.wait_for(lambda output: output.data != FAILSAFE, mark)
            self.assertEqual(first.what.data[0], CENTER_ON_CHIP)
            self.assertEqual(first.what.data[2:], (0,) * 14)
            self.wait_for_output(FAILSAFE)
        self.wait_for_warning("a command needs 16 values and has 0: refused", since=0)

    def test_what_is_no_duty_is_refused_and_its_neighbours_are_taken(self):
        log = self.log.mark()
        for wrong in (65536, 2 ** 31 - 1, -2, -2 ** 31):
            mark = self.outputs.mark()
            self.cmd_vector.publish(vector([wrong, 1600, wrong, 3200]))
            self.outputs.wait_for(lambda output: output.data == (CENTER_ON_CHIP, 1600, 0, 3200) + (0,) * 12, mark)
            self.wait_for_output(FAILSAFE)
        self.wait_for_warning("channels 0, 2 refused: 65536 of channel 0 is no duty; accepted: 0 to 65535, -1", log)

    def test_a_channel_goes_to_its_timeout_value_after_250_ms(self):
        def attempt():
            self.wait_for_output(FAILSAFE)
            mark = self.outputs.mark()
            sent_s = time.monotonic()
            self.cmd_vector.publish(vector([6000, 2000]))
            self.wait_for_output((6000, 2000) + (0,) * 14, mark)
            silence_s = self.wait_for_output(FAILSAFE, mark).at_s - sent_s
            self.assertGreaterEqual(silence_s, TIMEOUT_S)
            self.assertLess(silence_s, TIMEOUT_S + 0.1)
        retried(attempt)

    def test_each_channel_times_out_by_itself(self):
        self.inputs.hold(self.cmd_vector, vector([6000]))
        self.command.publish(vector([-1, 2000]))
        mark = self.outputs.mark()
        self.wait_for_output((6000, 2000) + (0,) * 14)
        self.wait_for_output((6000, 0) + (0,) * 14, mark)

    def test_an_unchanged_command_that_is_repeated_keeps_its_channel(self):
        """A car that goes straight on. Looked at over four timeouts."""
        def attempt():
            self.inputs.hold(self.cmd_vector, vector([6000]))
            held = self.wait_for_output((6000,) + (0,) * 15)
            mark = self.outputs.mark()
            self.outputs.wait_for(lambda _: time.monotonic() > held.at_s + 4 * TIMEOUT_S, mark)  # it beats at 1 Hz
            self.assertEqual({output.data[0] for output in self.outputs.since(mark)}, {6000})
        retried(attempt)

    def test_a_change_is_on_the_chip_at_once(self):
        def attempt():
            mark = self.outputs.mark()
            sent_s = time.monotonic()
            self.inputs.hold(self.cmd_vector, vector([4000]))
            self.assertLess(self.wait_for_output((4000,) + (0,) * 15, mark).at_s - sent_s, 0.05)
            self.inputs.drop()
            self.wait_for_output(FAILSAFE)
        retried(attempt)


class Pca9685ByItself(unittest.TestCase):
    def start(self, name, *arguments):
        """A node in a namespace of its own, and its outputs."""
        outputs = Topic(f"/{name}/output", Int32MultiArray)
        process = start_node(self, "pca9685", f"/servo/output:=/{name}/output", f"/servo/cmdVector:=/{name}/cmdVector",
                             f"command:=/{name}/command", *arguments, name=name)
        return process, outputs

    def test_scalars_stand_for_all_channels_and_lists_for_each(self):
        timeout_values = [16 * channel for channel in range(16)]
        pwm_max = [65535] * 15 + [4000]
        process, outputs = self.start("lists", "_device:=virtual", "_timeout:=60000",
                                      f"_timeout_value:={timeout_values}",
                                      "_pwm_min:=3200", f"_pwm_max:={pwm_max}")
        outputs.wait_for(lambda output: list(output.data) == timeout_values)
        Sender("/lists/command", Int32MultiArray).publish(vector(rest=0))
        outputs.wait_for(lambda output: output.data == (3200,) * 16)
        Sender("/lists/command", Int32MultiArray).publish(vector(rest=65535))
        outputs.wait_for(lambda output: output.data == (65535,) * 15 + (4000,))
        self.assertEqual(process.end(), 0)

    def test_a_frequency_of_50_hz_has_the_data_sheets_prescale_and_another_can_be_given(self):
        nominal, _ = self.start("nominal", "_device:=virtual")
        original, _ = self.start("original", "_device:=virtual", "_prescale:=122")
        nominal.wait_for_info(r"PCA9685 at 0x40 on virtual: running at 50\.03 Hz \(prescale 121\)")
        original.wait_for_info(r"running at 49\.62 Hz \(prescale 122\)")

    def test_bad_parameters_end_the_node_with_their_name(self):
        cases = [
            ("address", "_address:=0x80", r"address is 128; accepted: an integer from 64 to 127"),
            ("fifteen", f"_timeout:={[250] * 15}", "timeout is .*; accepted: 16 integers, or one for all of them"),
            ("too_high", f"_timeout_value:={[0] * 15 + [65536]}", r"timeout_value\[15\] is 65536; accepted: .*65535"),
            ("too_slow", "_frequency:=10", "frequency is 10.0; accepted: 23.8 to 1526 Hz"),
            ("unknown", "_timeouts:=250", "unknown parameter timeouts is 250; accepted: only"),
            ("crossed", "_pwm_min:=[9,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0]", None),
        ]
        started = [(name, pattern, self.start(name, "_device:=virtual", argument,
                                              *(["_pwm_max:=8"] if pattern is None else []))[0])
                   for name, argument, pattern in cases]
        for name, pattern, process in started:
            with self.subTest(name):
                self.assertEqual(process.wait_for_exit(), 1)
                lines = process.stderr.since()
                self.assertEqual(len(lines), 1, lines)
                self.assertRegex(lines[0], "FATAL.*: " + (pattern or r"pwm_min\[0\] is 9; accepted: at most pwm_max"))

    def test_a_bus_that_is_not_there_is_told_in_one_line_and_the_node_goes_on(self):
        with tempfile.TemporaryDirectory() as directory, tempfile.NamedTemporaryFile() as file:
            cases = [
                ("absent", "250", "PCA9685 at 0x40 on /dev/i2c-250: there is no such bus. .*ls /dev/i2c-\\*"),
                ("directory", directory, f"PCA9685 at 0x40 on {directory}: this is not an I2C bus. .*ls /dev/i2c-\\*"),
                ("file", file.name, f"PCA9685 at 0x40 on {file.name}: this is not an I2C bus. .*ls /dev/i2c-\\*"),
            ]
            started = [(*case, *self.start(case[0], f"_device:={case[1]}")) for case in cases]
            for name, _, pattern, process, outputs in started:
                with self.subTest(name):
                    process.wait_for_line(f"WARN.*{pattern}.* Trying again")
                    outputs.wait_for_count(2)  # at 1 Hz: it lives, and has tried a few times more
                    self.assertEqual(outputs.since()[-1].data, (-1,) * 16)
                    self.assertEqual(process.end(), 0)
                    self.assertEqual(len(process.stderr.since()), 1, process.stderr.since())

    def test_with_400_mb_of_address_space_it_runs_and_with_300_it_ends_with_one_line(self):
        outputs = Topic("/limited/output", Int32MultiArray)
        process = start(self, "sh", "-c", 'ulimit -v 400000; exec "$0" "$@"', executable("pca9685"), "_device:=virtual",
                        "/servo/output:=/limited/output", "/servo/cmdVector:=/limited/cmdVector", "__name:=limited")
        command = Sender("/limited/cmdVector", Int32MultiArray)
        command.publish(vector([6000]))
        outputs.wait_for(lambda output: output.data[0] == 6000)
        self.assertEqual(process.end(), 0)
        self.assertEqual(process.stderr.since(), [])
        process = start(self, "sh", "-c", 'ulimit -v 300000; exec "$0" "$@"', executable("pca9685"), "_device:=virtual")
        self.assertEqual(process.wait_for_exit(), 1)
        self.assertEqual("\n".join(process.stderr.since()), (
            "pca9685: it needs 380 MB of address space, and its limit is 292 MB: raise that in the shell that starts "
            "it (ulimit -v unlimited)"))

    @unittest.skipIf(os.getuid(), "only root can be two users")
    def test_another_users_folder_for_the_virtual_chip_is_told_in_one_line_and_not_used_until_it_is_gone(self):
        with tempfile.TemporaryDirectory() as shared, tempfile.TemporaryDirectory() as target:
            os.chmod(shared, 0o1777)
            folder = os.path.join(shared, f"car_interface-{os.getuid()}")
            cases = [("foreign", lambda: os.mkdir(folder), "is another user's: nobody's"),
                     ("linked", lambda: os.symlink(target, folder), "is a link, of nobody")]
            for name, make, cause in cases:
                with self.subTest(name):
                    make()
                    os.chown(folder, 65534, 65534, follow_symlinks=False)
                    outputs = Topic(f"/{name}/output", Int32MultiArray)
                    process = start(self, "env", f"TMPDIR={shared}", executable("pca9685"), "_device:=virtual",
                                    f"/servo/output:=/{name}/output", f"__name:={name}")
                    process.wait_for_line(f"WARN.*PCA9685 at 0x40 on virtual: {folder} {cause}. Have it removed "
                                          f".sudo rm -r {folder}.*Trying again")
                    outputs.wait_for_count(2)
                    self.assertEqual(outputs.since()[-1].data, (-1,) * 16)
                    self.assertEqual(len(process.stderr.since()), 1, process.stderr.since())
                    self.assertEqual(os.listdir(folder), [])
                    (os.unlink if os.path.islink(folder) else os.rmdir)(folder)
                    process.wait_for_info("running at")
                    self.assertEqual(os.stat(folder).st_mode & 0o7777, 0o700)
                    self.assertEqual(process.end(), 0)
                    eventually(lambda: not os.listdir(folder), "the chip has ended")
                    os.rmdir(folder)
            self.assertEqual(os.listdir(target), [])

    def test_a_bus_that_is_not_there_is_tried_again(self):
        """A pipe in its place tells when it is opened: a reader of a pipe sees a writer come and go."""
        with tempfile.TemporaryDirectory() as directory:
            path = os.path.join(directory, "bus")
            process, _ = self.start("tried_again", f"_device:={path}")
            process.wait_for_line("there is no such bus")
            os.mkfifo(path)
            reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
            self.addCleanup(os.close, reader)
            poll = select.poll()
            poll.register(reader, 0)
            self.assertEqual(poll.poll(1000 * PATIENCE_S), [(reader, select.POLLHUP)])
            self.assertEqual(process.end(), 0)

    def test_a_terminal_that_takes_no_more_lines_holds_nothing_up(self):
        """As after Ctrl-S, or when the ssh connection to it breaks: here a pipe that is full, and stays so."""
        with tempfile.TemporaryDirectory() as directory:
            terminal = os.path.join(directory, "terminal")
            os.mkfifo(terminal)
            end = os.open(terminal, os.O_RDWR | os.O_NONBLOCK)
            self.addCleanup(os.close, end)
            with self.assertRaises(BlockingIOError):
                while True:
                    os.write(end, b" " * 512)
            outputs = Topic("/gagged/output", Int32MultiArray)
            process = start(self, "sh", "-c", 'exec "$@" > "$0" 2>&1', terminal, executable("pca9685"),
                            "_device:=virtual", "/servo/output:=/gagged/output", "command:=/gagged/command",
                            "__name:=gagged")
            command = Sender("/gagged/command", Int32MultiArray)
            command.publish(vector([6000] * 15 + [70000]))  # is warned of
            outputs.wait_for(lambda output: output.data == (6000,) * 15 + (0,))
            command.publish(vector([5200]))
            outputs.wait_for(lambda output: output.data[0] == 5200)
            self.assertEqual(process.end(signal.SIGTERM), 0)
            self.assertEqual(outputs.since()[-1].data, (0,) * 16)

    def test_a_required_bus_that_is_not_there_ends_the_node(self):
        process, _ = self.start("required", "_device:=/dev/i2c-250", "_required:=true")
        self.assertEqual(process.wait_for_exit(), 1)
        lines = process.stderr.since()
        self.assertEqual(len(lines), 1, lines)
        self.assertRegex(lines[0], "FATAL.*: PCA9685 at 0x40 on /dev/i2c-250: there is no such bus")

    def test_a_signal_brings_timeout_values_for_a_period_and_then_full_off(self):
        timeout_values = [5104, 4912] + [0] * 14
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            with self.subTest(number):
                name = f"ended_by_{number.name.lower()}"
                process, outputs = self.start(name, "_device:=virtual", "_timeout:=60000",
                                              f"_timeout_value:={timeout_values}")
                Sender(f"/{name}/cmdVector", Int32MultiArray).publish(vector([6000, 6000, 6000]))
                outputs.wait_for(lambda output: output.data == (6000,) * 3 + (0,) * 13)
                mark = outputs.mark()
                self.assertEqual(process.end(number), 0)
                off = outputs.wait_for(lambda output: output.data == (0,) * 16, mark)
                last = [heard for heard in outputs.heard_since(mark) if heard.what.data[0] != 6000]
                self.assertEqual([list(heard.what.data) for heard in last], [timeout_values, [0] * 16])
                self.assertGreater(off.at_s - last[0].at_s, 0.010)  # 20 ms, if they arrive as they were sent
                self.assertEqual(process.stderr.since(), [])


    def test_at_exit_a_bus_that_fails_for_a_moment_is_tried_until_the_chip_is_off(self):
        process, outputs = self.start("ended_with_faults", "_device:=virtual", "_timeout:=60000")
        Sender("/ended_with_faults/cmdVector", Int32MultiArray).publish(vector([6000]))
        outputs.wait_for(lambda output: output.data[0] == 6000)
        inject("/ended_with_faults", "nack", 7)
        self.assertEqual(process.end(signal.SIGTERM), 0)
        self.assertEqual(outputs.since()[-1].data, (0,) * 16)

    def test_a_chip_that_cannot_be_reached_at_exit_is_said_to_go_on_pulsing_until_the_guard_reaches_it(self):
        folder, log = tempfile.mkdtemp(), self.log_path()
        self.addCleanup(shutil.rmtree, folder)
        chip = ChipLink(os.path.join(folder, "chip"), 0x40)
        self.addCleanup(chip.close)
        process, outputs = self.start("ended_in_vain", "_device:=virtual", "_timeout:=60000", "_timeout_value:=4912",
                                      f"_virtual_chip:={folder}/chip", f"_virtual_log:={log}", "_guard_off_after:=0.5")
        Sender("/ended_in_vain/cmdVector", Int32MultiArray).publish(vector([6000]))
        outputs.wait_for(lambda output: output.data[0] == 6000)
        chip.open()
        chip.inject("nack", 100_000)
        process.wait_for_line("was lost: nothing answers at this address")
        self.assertEqual(process.end(signal.SIGTERM), 1)
        process.wait_for_line("FATAL.*can't be switched off and goes on pulsing what it was last told. Cut its power; "
                              "its guard goes on trying for 10 minutes")
        ended_ns = time.monotonic_ns()
        chip.inject("nack", 0)
        eventually(lambda: "fd 10" in writes(log, ended_ns), "full off")
        written = writes(log, ended_ns)
        self.assertEqual(list(written), ["06 " + "00003301" * 8, "26 " + "00003301" * 8, "fd 10"])
        self.assertGreater(written["fd 10"] - written["26 " + "00003301" * 8], 0.1e9)

    def test_a_chip_that_lost_its_power_is_noticed_idle_or_driven_and_told_again(self):
        log = self.log_path()
        _, outputs = self.start("forgetful", "_device:=virtual", "_timeout_value:=4912", f"_virtual_log:={log}")
        outputs.wait_for(lambda output: output.data == (4912,) * 16)
        for driven in (False, True):
            with self.subTest(driven=driven):
                inputs = Repeater()
                self.addCleanup(inputs.end)
                if driven:
                    inputs.hold(Sender("/forgetful/cmdVector", Int32MultiArray), vector([6000]))
                    outputs.wait_for(lambda output: output.data[0] == 6000)
                lost_ns, mark = time.monotonic_ns(), outputs.mark()
                inject("/forgetful", "brownout", 0)
                # throttle_arb arms its ESC again by this
                outputs.wait_for(lambda output: output.data == (0,) * 16, mark)
                eventually(lambda since_ns=lost_ns: "fe 79" in writes(log, since_ns), "the prescale anew")
                eventually(lambda since_ns=lost_ns: any(write.startswith("26 ") for write in writes(log, since_ns)),
                           "channels 8 to 15 anew")
                self.assertLess(max(writes(log, lost_ns).values()) - lost_ns, 1e9)
                inputs.end()

    def test_commands_while_the_chip_is_away_are_dropped_and_counted_and_only_a_fresh_one_is_written(self):
        log = self.log_path()
        reports = Topic("/diagnostics", DiagnosticArray)
        process, outputs = self.start("away", "_device:=virtual", f"_virtual_log:={log}", "_timeout_value:=4912")
        command = Sender("/away/cmdVector", Int32MultiArray)
        outputs.wait_for(lambda output: output.data == (4912,) * 16)
        inject("/away", "power", 0)
        process.wait_for_line("was lost")
        inputs = Repeater(period_s=0.02)
        inputs.hold(command, vector([3000]))
        reports.wait_for(lambda array: int(self.value_of(array, "/away", "commands dropped while it was away")) > 20)
        inputs.end()
        process.wait_for_line("no command for channel 0: now at timeout value")
        mark = process.stdout.mark()
        inject("/away", "power", 1)
        process.wait_for_info("running at", mark)
        outputs.wait_for(lambda output: output.data == (4912,) * 16, outputs.mark())
        self.assertNotIn("06 0000bc00", writes(log))  # 3000 / 16 = 188 counts: it was never on the bus

    def log_path(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        return os.path.join(folder.name, "writes")

    @staticmethod
    def value_of(array, node, key):
        """A value of a node's report; 0 where it isn't there."""
        for status in array.status:
            if status.name.startswith(node.strip("/") + ": "):
                for pair in status.values:
                    if pair.key == key:
                        return pair.value
        return 0


def writes(log, since_ns=0):
    """What the virtual chip took since then: "register bytes" in hexadecimal, with the monotonic time of each."""
    with open(log, encoding="ascii") as file:
        rows = [row.split(" ", 2) for row in file.read().splitlines()]
    return {write: int(time_ns) for time_ns, _, write in rows if int(time_ns) > since_ns}


def inject(node, fault, value):
    rospy.wait_for_service(f"{node}/inject_fault", PATIENCE_S)
    answer = rospy.ServiceProxy(f"{node}/inject_fault", InjectFault)(fault, value)
    assert answer.success, answer.message


if __name__ == "__main__":
    rospy.init_node("pca9685_test")
    rostest.rosrun("car_interface", "pca9685_test", "__main__")
