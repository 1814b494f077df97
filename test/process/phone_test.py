#!/usr/bin/env python3
"""The phones' page in a real browser: thumbs drive the car's processes, and whatever becomes of the page stops them.

The exact times are those of test/graph/test_phone_drive.py. Here they are measured, up to the virtual chip:
CAR_INTERFACE_TRIALS sets how often (default 1, at most 20), CAR_INTERFACE_TABLE names a file for the table. Beside each
time stands how late a thread of this test woke up meanwhile. Bounds hold with CAR_INTERFACE_ALL only.
"""
from __future__ import annotations

import json
import operator
import os
import random
import signal
import statistics
import sys
import threading
import time

import rospy
import rostest

from closing import Measured
from relay import DOWN, UP, Relay
from virtual_car import CENTER, ESC_NEUTRAL, Car, free_port
from waiting import PACKAGE, config, eventually, skip

sys.path.append(os.path.join(PACKAGE, "test", "unit"))
from browser import Browser, find_browser

TRIALS = min(20, int(os.environ.get("CAR_INTERFACE_TRIALS", "1")))
STRICT = bool(os.environ.get("CAR_INTERFACE_ALL"))
PIN = "271828"
WITHIN_S = 60
ATTEMPT_S = 2
NEUTRALS = (CENTER, ESC_NEUTRAL)
MAX_STOP_MS = 550
STAYS_S = 0.4  # that it stands is watched
DELAYS_S = 0.025, 0.075  # each way: a round trip of 100 ± 50 ms
JITTER_S = 60 if STRICT else 2  # is driven
LATE_MS = 50  # what a round trip of 150 ms and the 50 ms between two tokens leave of 250 ms
PAUSE_S = 0.5  # of a person who touches again
NODE, RELAY = "127.0.0.2", "127.0.0.1"  # the node answers under both names; browsers reach it by way of the relay
# What must be seen whole at each size, without scrolling and without overlapping.
PARTS = ("state", "stops", "car", "chips", "buttons", "pad-left", "pad-right")
SIZES = ((360, 640), (740, 340), (768, 1024), (1280, 800))
RECTANGLES = """
(ids => ids.map(id => { const r = document.getElementById(id).getBoundingClientRect();
                        return [r.left, r.top, r.right, r.bottom].map(Math.round); }))(%s)"""


class Lateness:
    """How late a thread wakes up that sleeps 1 ms: of the computer, not of the car. A context manager.

    Attributes:
        max_ms: the worst.
    """

    def __enter__(self):
        self.max_ms, self._ends = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ends.set()
        self._thread.join()

    def _run(self):
        before_s = time.monotonic()
        while not self._ends.wait(0.001):
            now_s = time.monotonic()
            self.max_ms, before_s = max(self.max_ms, 1000 * (now_s - before_s) - 1), now_s


class Phone(Measured):
    other = None

    @classmethod
    def setUpClass(cls):
        cls.path = find_browser()
        if not cls.path:
            return
        cls.car = car = Car(cls.addClassCleanup)
        car.load(teleop_logi=config("teleop_logi.yaml"))
        for start in (car.pca9685, car.turn_arb, car.throttle_arb):
            start()
        car.node("teleop_logi")
        port = free_port()
        cls.url = f"http://{RELAY}:{port}/"
        cls.node = car.node("phone_drive", f"_address:={NODE}", f"_port:={port}", f"_pin:={PIN}")
        car.sent(car.driver("rest", "e_stop"), "e_stop", "0")
        cls.node.wait_for_info("Phones")
        cls.relay = Relay((RELAY, port), (NODE, port))
        cls.browser = cls.open()

    def setUp(self):
        if not self.path:
            skip(self, "there is no Chromium")

    @classmethod
    def open(cls, at=RELAY):
        browser = Browser(cls.path, 500)
        cls.addClassCleanup(browser.__exit__)
        browser.open(f"{cls.url.replace(RELAY, at)}#{PIN}")
        browser.be_phone(*SIZES[0])
        eventually(lambda: browser.evaluate("document.body.className") != "apart", "a page that is admitted", WITHIN_S)
        return browser

    @classmethod
    def second(cls):
        """Return the page of another phone, which reaches the node directly."""
        cls.other = cls.other or cls.open(NODE)
        return cls.other

    def text(self, name, browser=None):
        return (browser or self.browser).evaluate(f"document.getElementById('{name}').textContent")

    def shown(self, browser=None):
        """What the page says."""
        return ", ".join(self.text(name, browser) for name in ("who", "why", "answer", "seat"))

    def middle(self, name, browser=None):
        (left, top, right, bottom), = (browser or self.browser).evaluate(RECTANGLES % json.dumps([name]))
        return (left + right) / 2, (top + bottom) / 2

    def tap(self, name, browser=None):
        browser = browser or self.browser
        browser.touch("touchStart", self.middle(name, browser))
        browser.touch("touchEnd")

    def push(self, browser=None):
        """Put down both thumbs and push."""
        browser = browser or self.browser
        left, right = self.middle("pad-left", browser), self.middle("pad-right", browser)
        browser.touch("touchStart", left, right)
        browser.touch("touchMove", (left[0] - 40, left[1]), (right[0], right[1] - 40))

    def lift(self, browser=None):
        (browser or self.browser).touch("touchEnd")

    def take_seat(self, browser=None):
        """Press Drive, where there is nobody in the seat: a page that was held up has lost it."""
        deadline_s = time.monotonic() + WITHIN_S
        while self.text("seat", browser) == "Drive":  # on a busy computer a press may be too old when it arrives
            self.tap("seat", browser)
            until_s = time.monotonic() + 1
            eventually(lambda: self.text("seat", browser) != "Drive" or time.monotonic() > until_s,
                       "the driver's seat")
            self.assertLess(until_s, deadline_s, self.text("why", browser))

    def drive(self, browser=None):
        """Take the seat if need be, and push until the car drives. Return when, ns."""
        return self.drive_by(lambda: self.push(browser), lambda: self.lift(browser), operator.lt, browser)

    def drive_by(self, push, lift, steers, browser=None):
        """The same with other hands. The ESC may still arm, and a page that was held up wants all to be touched anew.

        ``steers`` compares channel 0 with the center.
        """
        deadline_s = time.monotonic() + WITHIN_S
        while True:
            self.take_seat(browser)
            at_ns = time.monotonic_ns()
            push()
            try:
                self.car.chip.wait_for(0, lambda counts: steers(counts, CENTER), at_ns, ATTEMPT_S)
                self.car.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, at_ns, ATTEMPT_S)
                return at_ns
            except AssertionError as error:
                shown = self.shown(browser)
                lift()
                if time.monotonic() > deadline_s:
                    raise AssertionError(f"{error}: {shown}") from None

    def measure(self, title, fault, restore=lambda: None, bound_ms=MAX_STOP_MS, resume=lambda: None):
        """Make a fault while it drives, wait until it stands, and see that it stays so while the thumbs stay.

        Args:
            title: of the row.
            fault, restore, resume: called while it drives, once it stands, and once it was seen to stay so.
            bound_ms: of the median.
        """
        times_ms, lates_ms = [], []
        for _ in range(TRIALS):
            self.drive()
            with Lateness() as lateness:
                fault_ns = time.monotonic_ns()
                fault()
                stood_ns = self.stands(fault_ns)
            times_ms.append((stood_ns - fault_ns) / 1e6)
            lates_ms.append(lateness.max_ms)
            restore()
            self.wait(STAYS_S)
            self.stood_since(stood_ns, title)
            resume()
        row = (f"{title} | servo and ESC | {TRIALS} | {statistics.median(times_ms):.1f} | {max(times_ms):.1f} | "
               f"late {max(lates_ms):.1f}")
        self.add_row(row)
        if STRICT:
            self.assertLessEqual(statistics.median(times_ms), bound_ms, row)

    def wait(self, seconds):
        until_s = time.monotonic() + seconds
        eventually(lambda: time.monotonic() > until_s, f"{seconds} s")

    def stood_since(self, stood_ns, title):
        for channel in (0, 1):
            self.assertLessEqual(set(self.car.chip.values_since(channel, stood_ns)), {NEUTRALS[channel]}, title)

    def choose(self, thumbs):
        self.browser.evaluate(f"""(() => {{ const select = document.getElementById('thumbs'); select.value = '{thumbs}';
                                            select.dispatchEvent(new Event('change')); }})()""")

    def stands(self, since_ns):
        """Return when it stood for good, ns: nodes that a busy computer held up may stop it for a moment before."""
        deadline_s = time.monotonic() + WITHIN_S
        while True:
            stood_ns = max(self.car.chip.wait_for(channel, lambda counts, channel=channel: counts == NEUTRALS[channel],
                                                  since_ns, WITHIN_S) for channel in (0, 1))
            self.wait(STAYS_S)
            try:
                self.stood_since(stood_ns, "at rest")
                return stood_ns
            except AssertionError:
                if time.monotonic() > deadline_s:
                    raise
                since_ns = time.monotonic_ns()

    def test_1_whatever_becomes_of_the_page_or_a_viewer_s_stop_stops_it_and_it_stays_so(self):
        def cleared():
            self.take_seat()
            if self.text("who") == "Emergency stop":
                self.tap("clear")
            return self.text("who") == "Touch to drive"

        def clear():
            self.lift()
            eventually(lambda: self.text("who") == "Emergency stop", "the driver's page to show it", WITHIN_S)
            self.assertTrue(viewer.evaluate("document.getElementById('clear').disabled"))
            # A person is slower than the next token; one that is older than the stop clears nothing.
            eventually(cleared, lambda: f"a stop that is cleared: {self.shown()}", WITHIN_S)

        self.measure("thumbs lifted", self.lift, bound_ms=60)
        self.measure("another tab in front", lambda: self.browser.hide(True), lambda: self.browser.hide(False),
                     resume=self.lift)
        self.measure("phone turned", lambda: self.browser.be_phone(*SIZES[1]),
                     lambda: self.browser.be_phone(*SIZES[0]), resume=self.lift)
        self.measure("browser frozen", lambda: self.browser.signal(signal.SIGSTOP),
                     lambda: self.browser.signal(signal.SIGCONT), resume=self.lift)
        self.measure("page loaded again", self.browser.reload, resume=self.lift)
        viewer = self.second()
        self.measure("stop by a viewer", lambda: self.tap("stop", viewer), clear, 60)

    def test_2_keys_and_one_stick_drive_it_too_and_everything_is_seen_at_each_size_and_nothing_jumps(self):
        self.browser.be_phone(*SIZES[-1])
        self.drive()
        self.lift()

        def keys(does, which="mwd"):
            for key in which:
                self.browser.key(does, key)

        self.drive_by(lambda: keys("keyDown"), lambda: keys("keyUp"), operator.gt)
        keys("keyUp", "m")
        self.stands(time.monotonic_ns())
        keys("keyUp", "wd")
        self.choose("one")
        x, y = self.middle("pad-left")

        def push():
            self.browser.touch("touchStart", (x, y))
            self.browser.touch("touchMove", (x + 40, y - 40))

        def at_rest():
            if self.text("seat") == "Drive":  # a page that was held up for 1.5 s has connected anew
                self.tap("seat")
            return self.text("who") == "Touch to drive"

        pressed_ns = self.drive_by(push, self.lift, operator.gt)
        self.choose("left")  # with the thumb still down
        self.stands(pressed_ns)
        self.lift()
        for width, height in SIZES:
            with self.subTest(f"{width} x {height}"):
                self.browser.be_phone(width, height, is_dark=width > 700)
                resting = self.browser.evaluate(RECTANGLES % json.dumps(PARTS))
                for index, (left, top, right, bottom) in enumerate(resting):
                    self.assertTrue(0 <= left < right <= width and 0 <= top < bottom <= height, PARTS[index])
                    for other in resting[:index]:
                        self.assertTrue(left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1])
                self.assertEqual(self.browser.evaluate("document.documentElement.scrollWidth"), width)
                self.push()
                eventually(lambda: self.text("who") != "Touch to drive", "another state", WITHIN_S)
                self.assertEqual(self.browser.evaluate(RECTANGLES % json.dumps(PARTS)), resting)
                self.browser.touch("touchEnd")
                eventually(at_rest, lambda: f"the state at rest: {self.shown()}", WITHIN_S)
        # A page that has connected anew complains about its old connection.
        complaints = [one for one in self.browser.complaints if "WebSocket connection to" not in json.dumps(one)]
        self.assertEqual(complaints, [])
        self.assertEqual([url for url in self.browser.requests if not url.startswith((self.url, "ws:"))], [])

    def test_3_network_that_is_gone_late_or_delivers_old_messages_moves_nothing_and_another_phone_takes_over(self):
        relay = self.relay
        self.browser.be_phone(*SIZES[0])

        def reconnected():
            """Wait for the page's next connection; it begins one after 1.5 s of silence."""
            relay.mend()
            eventually(lambda: relay.count > self.count and "apart" not in self.browser.evaluate(
                "document.body.className"), "a page that is admitted again", WITHIN_S)

        def held():
            self.count = relay.count
            relay.hold(UP)

        def cut():
            self.count = relay.count
            relay.cut()

        self.measure("network cut", cut, reconnected, resume=self.lift)
        # Echoes of the thumbs on their pads, each with a token that was fresh when it was sent.
        self.measure("burst after a pause", held, lambda: (self.wait(PAUSE_S), relay.release()), resume=self.lift)
        if STRICT:
            self.measure("burst after a reconnect", held, resume=self.lift, restore=lambda: (
                self.wait(PAUSE_S), relay.hold(DOWN), reconnected(), relay.release()))
        other = self.second()
        self.replace("phone replaced, left", other, lambda: self.browser.evaluate(
            "document.getElementById('seat').click()"), lambda: None)  # with both thumbs down
        if STRICT:
            self.replace("phone replaced, away", other, cut, reconnected)
        relay.delay_s = lambda: random.uniform(*DELAYS_S)
        self.drive_by_jitter()
        relay.delay_s = lambda: 0.0

    def replace(self, title, other, fault, restore):
        """Have another phone take the seat and drive: the first one's thumbs, which stay, count for nothing."""
        def is_taken():
            if self.text("seat", other) == "Drive":
                self.tap("seat", other)
                self.wait(0.3)
            return self.text("seat", other) == "Leave"

        def taken_over():
            eventually(is_taken, "the seat for another phone", WITHIN_S)

        def hand_back():
            self.drive(other)
            restore()
            self.lift(other)
            lifted_ns = time.monotonic_ns()
            stood_ns = self.stands(lifted_ns)
            self.wait(STAYS_S)
            self.stood_since(stood_ns, title)
            self.tap("seat", other)
            self.lift()
            eventually(lambda: self.text("seat", other) == "Drive", "a seat that is free", WITHIN_S)

        self.measure(title, fault, taken_over, resume=hand_back)

    def drive_by_jitter(self):
        """Drive, and touch again as a person would after a loss; see how much of the time the touch counts."""
        self.drive()
        since_ns, losses = time.monotonic_ns(), 0
        with Lateness() as lateness:
            while time.monotonic_ns() < since_ns + JITTER_S * 1e9:
                self.wait(0.1)
                if self.car.chip.counts(1) == ESC_NEUTRAL:
                    losses += 1
                    self.lift()
                    self.wait(PAUSE_S)
                    self.drive()
        share = self.car.chip.share(1, lambda counts: counts > ESC_NEUTRAL, since_ns, time.monotonic_ns())
        row = (f"round trip of 100 ± 50 ms | ESC | {JITTER_S} s | {share:.1%} | {losses} losses | "
               f"late {lateness.max_ms:.1f}")
        self.add_row(row)
        if STRICT and lateness.max_ms < LATE_MS:
            self.assertGreaterEqual(share, 0.99, row)
        self.lift()


if __name__ == "__main__":
    rospy.init_node("phone_test")
    rostest.rosrun("car_interface", "phone_test", "__main__")
