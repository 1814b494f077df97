#!/usr/bin/env python3
"""What stops the car when its real processes are killed, frozen or ended.

The exact times are those of test/graph/test_chain.py. Here they are measured: CAR_INTERFACE_TRIALS sets how often each
fault is made (default 1), CAR_INTERFACE_TABLE names a file for the table. Bounds hold with CAR_INTERFACE_ALL only.
"""
from __future__ import annotations

import glob
import os
import re
import shutil
import signal
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import rospy
import rostest

from closing import Measured
from virtual_car import CENTER, ESC_NEUTRAL, HERE, LEFT, PYTHON38, Car, guard_of
from waiting import config, eventually, skip

TRIALS = int(os.environ.get("CAR_INTERFACE_TRIALS", "1"))
STRICT = bool(os.environ.get("CAR_INTERFACE_ALL"))
ATTEMPT_S, HOLD_WITHIN_S = 3.0, 90.0
STALL_S = 0.6  # more than the half second from which on a node that stood still obeys nothing
HOUR_S = 3600
CLOCK_CACHE_S = 1  # libfaketime reads its file so often: at each call it would cost a core
NEUTRALS = (CENTER, ESC_NEUTRAL)


class Driven(Measured):
    """A car of processes with a master of its own, which drives by a gamepad and a planner's throttle."""

    @classmethod
    def setUpClass(cls):
        cls.car = cls.make_car()
        cls.rest = cls.car.driver("rest", "acceleration", "odometry", "e_stop")
        for name, value in (("odometry", "1.0"), ("acceleration", "1.0"), ("e_stop", "0")):
            cls.car.sent(cls.rest, name, value)

    def hold(self, deadman="joy"):
        """Let go of the deadman and hold it again, until the car drives."""
        deadline_s = time.monotonic() + HOLD_WITHIN_S
        while True:
            driver = self.car.processes["pad"]
            let_go_ns = self.car.sent(driver, deadman, "0")
            eventually(lambda: time.monotonic_ns() - let_go_ns > 0.3e9, "a rest of the sticks")
            held_ns = self.car.sent(driver, deadman, "1.0")
            try:
                self.car.chip.wait_for(0, lambda counts: counts == LEFT, held_ns, ATTEMPT_S)
                self.car.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, held_ns, ATTEMPT_S)
                return
            except AssertionError as error:  # a node joined too late to see the release
                if time.monotonic() > deadline_s:
                    said = {name: [*process.stdout.since()[-4:], *process.stderr.since()[-4:]]
                            for name, process in self.car.processes.items()}
                    raise AssertionError(f"{error}; {said}") from None

    def neutral_ns(self, since_ns, channels=(0, 1)):
        """When the servo was at its center, and the ESC at neutral."""
        return [self.car.chip.wait_for(channel, lambda counts, neutral=NEUTRALS[channel]: counts == neutral, since_ns)
                for channel in channels]

    def hold_meanwhile(self, frozen_ns, deadman="joy"):
        """Let go of the deadman and hold it again while a process is frozen, once it has stood still for too long.

        Just before it goes on: of a backlog rospy keeps only the newest messages.
        """
        eventually(lambda: time.monotonic_ns() - frozen_ns > STALL_S * 1e9, "a stall that takes control away")
        for value in ("0", "1.0"):
            self.car.sent(self.car.processes["pad"], deadman, value)

    def check_that_it_stands(self, channels=(0, 1), was_frozen=False):
        """For 0.3 s from now on, but for what a process was about to send when it was frozen."""
        since_ns = time.monotonic_ns()
        eventually(lambda: time.monotonic_ns() - since_ns > 0.3e9, "0.3 s")
        for channel in channels:
            values = self.car.chip.values_since(channel, since_ns)
            self.assertLessEqual({*values[2 * was_frozen:], self.car.chip.counts(channel)}, {NEUTRALS[channel]})

    def measure(self, title, fault, restore, bound_ms, channels=(0, 1)):
        """Make a fault, wait until the car stands, and bring back what it took away."""
        times: dict = {channel: [] for channel in channels}
        for _ in range(TRIALS):
            fault_ns = fault()
            for channel, at_ns in zip(channels, self.neutral_ns(fault_ns, channels)):
                times[channel].append((at_ns - fault_ns) / 1e6)
            restore()
        for channel, times_ms in times.items():
            row = (f"{title} | {('servo', 'ESC')[channel]} | {TRIALS} | {statistics.median(times_ms):.2f} | "
                   f"{max(times_ms):.2f}")
            self.add_row(row)
            if STRICT:
                self.assertLessEqual(max(times_ms), bound_ms, row)


class Chain(Driven):
    @classmethod
    def make_car(cls):
        car = Car(cls.addClassCleanup)
        car.load(teleop_logi=config("teleop_logi.yaml"))
        for start in (car.pca9685, car.turn_arb, car.converter, car.throttle_arb):
            start()
        car.node("teleop_logi")
        car.driver("pad", "joy")
        return car

    def send(self, name, number):
        return int(self.car.processes[name].send(number) * 1e9)

    def lose(self, name, number):
        self.lost_ns = self.send(name, number)
        if number == signal.SIGKILL:
            self.car.processes[name].wait_for_exit()
        return self.lost_ns

    def bring_back(self, name, number, start, drives_on, channels):
        """Nothing moves until the deadman was let go, except where ``drives_on``; what was sent meanwhile is lost."""
        if number == signal.SIGSTOP:
            if name == "pad":
                eventually(lambda: time.monotonic_ns() - self.lost_ns > STALL_S * 1e9, "a stall")
            else:
                self.hold_meanwhile(self.lost_ns)
            self.send(name, signal.SIGCONT)
        else:
            start()
        if not drives_on:
            self.check_that_it_stands(channels, number == signal.SIGSTOP)
        self.hold()

    def test_1_messages_stop_it(self):
        self.hold()
        pad = self.car.processes["pad"]
        for title, driver, name, value in (
                ("deadman released", pad, "joy", "0"), ("e_stop true", self.rest, "e_stop", "1"),
                ("joystick NaN", pad, "joy", "nan")):
            def restore():
                self.car.sent(self.rest, "e_stop", "0")
                self.hold()
            self.measure(title, lambda fault=(driver, name, value): self.car.sent(*fault), restore, 20)

    def test_2_each_process_that_is_killed_or_frozen_stops_it_and_it_stands_until_the_deadman_was_let_go(self):
        self.hold()
        car = self.car
        losses = [("pad", lambda: car.driver("pad", "joy"), 300, (0, 1)),
                  ("teleop_logi", lambda: car.node("teleop_logi"), 550, (0, 1)),
                  ("turn_arb", car.turn_arb, 300, (0, 1)), ("throttle_arb", car.throttle_arb, 300, (1,)),
                  ("pca9685", car.pca9685, 350, (0, 1))]
        for name, start, bound_ms, channels in losses:
            for title, number in (("frozen", signal.SIGSTOP), ("killed", signal.SIGKILL)):
                with self.subTest(f"{name} {title}"):
                    self.measure(
                        f"{name} {title}", lambda name=name, number=number: self.lose(name, number),
                        lambda name=name, number=number, start=start, channels=channels: self.bring_back(
                            name, number, start, name == "pca9685", channels), bound_ms, channels)
        said = "".join(Path(path).read_text(encoding="utf-8") for path in glob.glob(f"{car.folder}/*-guard.log"))
        for word in ("silent", "dead"):
            self.assertRegex(said, f"guard of 0x40 on .*, node [0-9]+: the node is {word}")

    def test_3_guard_that_is_killed_or_frozen_is_replaced_and_the_next_one_acts(self):
        for number in (signal.SIGKILL, signal.SIGSTOP):
            process = self.car.processes["pca9685"]
            guard = eventually(lambda process=process: guard_of(process.pid), "a guard")
            marks = process.stderr.mark(), process.stdout.mark()
            os.kill(guard, number)
            process.stderr.wait_for(lambda line: "guard absent" in line, marks[0])
            process.stdout.wait_for(lambda line: "watches again" in line, marks[1])
            self.assertNotEqual(guard_of(process.pid), guard)
            self.neutral_ns(self.lose("pca9685", signal.SIGKILL))
            self.car.pca9685().wait_for_info("running at")

    def test_4_pca9685_that_is_ended_centers_and_then_switches_off(self):
        self.hold()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            ended_ns = self.send("pca9685", number)
            neutral_ns = self.neutral_ns(ended_ns)
            for channel, at_ns in enumerate(neutral_ns):
                off_ns = self.car.chip.wait_for(channel, lambda counts: counts == 0, at_ns)
                self.assertGreater(off_ns - at_ns, 39e6)
            self.assertEqual(self.car.processes["pca9685"].wait_for_exit(), 0)
            self.car.pca9685().wait_for_info("running at")

    def test_5_drive_goes_on_without_the_master_and_is_warned_about(self):
        self.hold()
        killed_ns = self.send("master", signal.SIGKILL)
        self.car.processes["turn_arb"].wait_for_line("WARN.*the ROS master is gone.*")
        if STRICT:  # a computer that stands still takes control away, as it should
            self.assertEqual(self.car.chip.values_since(0, killed_ns), [])
        self.hold()
        self.neutral_ns(self.car.sent(self.car.processes["pad"], "joy", "0"))


class OneProcess(Driven):
    """car_nodes, with a clock that can be set."""

    @classmethod
    def make_car(cls):
        library = glob.glob("/usr/lib/*/faketime/libfaketimeMT.so.1")
        cls.clock, cls.has_clock = os.path.join(tempfile.mkdtemp(), "clock"), bool(library)
        cls.addClassCleanup(shutil.rmtree, os.path.dirname(cls.clock))
        monotonic = f"{cls.clock}.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-o", monotonic, os.path.join(HERE, "monotonic_clock.c"), "-ldl"],
                       check=True)
        cls.set_clock(0)
        faked = {"LD_PRELOAD": f"{monotonic}:{library[0]}", "FAKETIME_TIMESTAMP_FILE": cls.clock,
                 "FAKETIME_CACHE_DURATION": str(CLOCK_CACHE_S), "FAKETIME_DONT_FAKE_MONOTONIC": "1",
                 "NO_FAKE_STAT": "1"} if library else {}  # byte code counts by the time of its source
        car = Car(cls.addClassCleanup, faked, python38=bool(STRICT and PYTHON38))
        car.load(car_nodes={"throttle": True})
        car.one_process()
        car.driver("pad", "human", "steering")
        car.sent(car.processes["pad"], "steering", "1.0")
        return car

    @classmethod
    def set_clock(cls, offset_s):
        with open(f"{cls.clock}.new", "w", encoding="ascii") as file:
            file.write(f"{offset_s:+d}s\n")
        os.replace(f"{cls.clock}.new", cls.clock)

    def test_clock_that_is_set_by_an_hour_moves_nothing_and_a_silent_deadman_stops_it(self):
        if not self.has_clock:
            skip(self, "there is no libfaketime")
        self.hold("human")
        process, pad = self.car.processes["car_nodes"], self.car.processes["pad"]
        for offset_s in (HOUR_S, -HOUR_S):
            self.set_clock(offset_s)
            set_ns = time.monotonic_ns()
            eventually(lambda set_ns=set_ns: time.monotonic_ns() - set_ns > 1.5e9 * CLOCK_CACHE_S, "a set clock")
            mark = process.stderr.mark()

            def fall_silent():
                pad.tell("human -")
                return time.monotonic_ns()
            self.measure(f"clock set by {offset_s} s, then human_in_loop silent", fall_silent, lambda: None, 650)
            line = process.wait_for_line("human_in_loop (silent|was not heard)", mark)
            shown_s = float(re.search(r"\[(\d+\.\d+)\]", line).group(1))
            self.assertAlmostEqual(shown_s, time.time() + offset_s, delta=60)
            self.hold("human")
        self.set_clock(0)

    def test_guard_acts_when_it_is_frozen_or_killed_and_its_parts_obey_nothing_that_was_sent_meanwhile(self):
        """The parts share the connections of their process."""
        self.hold("human")
        process = self.car.processes["car_nodes"]

        def go_on():
            self.hold_meanwhile(time.monotonic_ns(), "human")
            process.send(signal.SIGCONT)
            for part in ("turn_arb", "throttle_arb", "pca9685"):
                process.wait_for_line(f"WARN.*{part}: node stood still")
            self.check_that_it_stands(was_frozen=True)
            self.hold("human")
        self.measure("car_nodes frozen", lambda: int(process.send(signal.SIGSTOP) * 1e9), go_on, 350)
        self.measure("car_nodes killed", lambda: int(self.car.processes["car_nodes"].send(signal.SIGKILL) * 1e9),
                     lambda: self.car.one_process() and self.hold("human"), 350)


if __name__ == "__main__":
    rospy.init_node("chain_test")
    rostest.rosrun("car_interface", "chain_test", "__main__")
