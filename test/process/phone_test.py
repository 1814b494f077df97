#!/usr/bin/env python3
"""The phones' page in a real browser: thumbs drive the car's processes, and whatever becomes of the page stops them.

The exact times are those of test/graph/test_phone_drive.py. Here they are measured, up to the virtual chip:
CAR_INTERFACE_TRIALS sets how often (default 1, at most 20), CAR_INTERFACE_TABLE names a file for the table. Beside each
time stands how late a thread of this test woke up meanwhile. Bounds hold with CAR_INTERFACE_ALL only.
"""
from __future__ import annotations

import json
import os
import signal
import statistics
import sys
import threading
import time
import unittest
from typing import ClassVar

import rospy
import rostest

from virtual_car import CENTER, ESC_NEUTRAL, Car, free_port
from waiting import PACKAGE, eventually, skip

sys.path.append(os.path.join(PACKAGE, "test", "unit"))
from browser import Browser, find_browser

TRIALS = min(20, int(os.environ.get("CAR_INTERFACE_TRIALS", "1")))
TABLE = os.environ.get("CAR_INTERFACE_TABLE")
STRICT = bool(os.environ.get("CAR_INTERFACE_ALL"))
PIN = "271828"
WITHIN_S = 60
ATTEMPT_S = 2
NEUTRALS = (CENTER, ESC_NEUTRAL)
MAX_STOP_MS = 550
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


class Phone(unittest.TestCase):
    rows: ClassVar[list] = []

    @classmethod
    def setUpClass(cls):
        cls.path = find_browser()
        if not cls.path:
            return
        cls.car = car = Car(cls.addClassCleanup)
        car.load_actors()
        car.load("/teleop_logi", "teleop_logi.yaml")
        for start in (car.pca9685, car.turn_arb, car.throttle_arb):
            start()
        car.node("teleop_logi")
        cls.url = f"http://127.0.0.1:{free_port()}/"
        cls.node = car.node("phone_drive", f"_port:={cls.url.split(':')[2][:-1]}", f"_pin:={PIN}")
        car.sent(car.driver("rest", "e_stop"), "e_stop", "0")
        cls.node.wait_for_info("Phones")
        cls.browser = cls.open()

    @classmethod
    def tearDownClass(cls):
        if TABLE and cls.rows:
            with open(TABLE, "a", encoding="utf-8") as file:
                file.write("\n".join(cls.rows) + "\n")

    def setUp(self):
        if not self.path:
            skip(self, "there is no Chromium")

    @classmethod
    def open(cls):
        browser = Browser(cls.path, 500)
        cls.addClassCleanup(browser.__exit__)
        browser.open(f"{cls.url}#{PIN}")
        browser.be_phone(*SIZES[0])
        eventually(lambda: browser.evaluate("document.body.className") != "apart", "a page that is admitted", WITHIN_S)
        return browser

    def text(self, name):
        return self.browser.evaluate(f"document.getElementById('{name}').textContent")

    def middle(self, name, browser=None):
        (left, top, right, bottom), = (browser or self.browser).evaluate(RECTANGLES % json.dumps([name]))
        return (left + right) / 2, (top + bottom) / 2

    def tap(self, name, browser=None):
        browser = browser or self.browser
        browser.touch("touchStart", self.middle(name, browser))
        browser.touch("touchEnd")

    def push(self):
        """Put down both thumbs and push; return when the first was put down, ns."""
        left, right = self.middle("pad-left"), self.middle("pad-right")
        at_ns = time.monotonic_ns()
        self.browser.touch("touchStart", left, right)
        self.browser.touch("touchMove", (left[0] - 40, left[1]), (right[0], right[1] - 40))
        return at_ns

    def drive(self):
        """Take the seat if need be, and push until the car drives: the ESC may still arm."""
        deadline_s = time.monotonic() + WITHIN_S
        while True:
            while self.text("seat") == "Drive":  # on a busy computer a press may be too old when it arrives
                self.tap("seat")
                until_s = time.monotonic() + 1
                eventually(lambda: self.text("seat") != "Drive" or time.monotonic() > until_s, "the driver's seat")
                self.assertLess(until_s, deadline_s, self.text("why"))
            at_ns = self.push()
            try:
                self.car.chip.wait_for(0, lambda counts: counts < CENTER, at_ns, ATTEMPT_S)
                self.car.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, at_ns, ATTEMPT_S)
                return
            except AssertionError:
                self.browser.touch("touchEnd")
                if time.monotonic() > deadline_s:
                    raise

    def measure(self, title, fault, restore=lambda: None, bound_ms=MAX_STOP_MS):
        """Make a fault while it drives, wait until it stands, and see that it stays so while the thumbs stay."""
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
            until_ns = time.monotonic_ns() + 0.4e9
            eventually(lambda: time.monotonic_ns() > until_ns, "0.4 s")
            for channel in (0, 1):
                self.assertLessEqual(set(self.car.chip.values_since(channel, stood_ns)), {NEUTRALS[channel]}, title)
        row = (f"{title} | servo and ESC | {TRIALS} | {statistics.median(times_ms):.1f} | {max(times_ms):.1f} | "
               f"late {max(lates_ms):.1f}")
        print(row, flush=True)
        self.rows.append(row)
        if STRICT:
            self.assertLessEqual(statistics.median(times_ms), bound_ms, row)

    def choose(self, thumbs):
        self.browser.evaluate(f"""(() => {{ const select = document.getElementById('thumbs'); select.value = '{thumbs}';
                                            select.dispatchEvent(new Event('change')); }})()""")

    def stands(self, since_ns):
        """Return when it stood, ns."""
        return max(self.car.chip.wait_for(channel, lambda counts, channel=channel: counts == NEUTRALS[channel],
                                          since_ns, WITHIN_S) for channel in (0, 1))

    def test_1_whatever_becomes_of_the_page_or_a_viewer_s_stop_stops_it_and_it_stays_so(self):
        def lift():
            self.browser.touch("touchEnd")

        def cleared():
            if self.text("who") == "Emergency stop":
                self.tap("clear")
            return self.text("who") == "Touch to drive"

        def clear():
            lift()
            eventually(lambda: self.text("who") == "Emergency stop", "the driver's page to show it", WITHIN_S)
            self.assertTrue(viewer.evaluate("document.getElementById('clear').disabled"))
            # A person is slower than the next token; one that is older than the stop clears nothing.
            eventually(cleared, "a stop that is cleared", WITHIN_S)

        self.measure("thumbs lifted", lift, bound_ms=60)
        self.measure("another tab in front", lambda: self.browser.hide(True),
                     lambda: (self.browser.hide(False), lift()))
        self.measure("phone turned", lambda: self.browser.be_phone(*SIZES[1]),
                     lambda: (self.browser.be_phone(*SIZES[0]), lift()))
        self.measure("browser frozen", lambda: self.browser.signal(signal.SIGSTOP),
                     lambda: self.browser.signal(signal.SIGCONT))
        lift()
        self.measure("page loaded again", self.browser.reload, lift)
        viewer = self.open()
        self.measure("stop by a viewer", lambda: self.tap("stop", viewer), clear, 60)

    def test_2_keys_and_one_stick_drive_it_too_and_everything_is_seen_at_each_size_and_nothing_jumps(self):
        self.browser.be_phone(*SIZES[-1])
        self.drive()
        self.browser.touch("touchEnd")
        for key in "mwd":
            self.browser.key("keyDown", key)
        pressed_ns = time.monotonic_ns()
        self.car.chip.wait_for(0, lambda counts: counts > CENTER, pressed_ns, WITHIN_S)
        self.car.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, pressed_ns, WITHIN_S)
        self.browser.key("keyUp", "m")
        self.stands(time.monotonic_ns())
        for key in "wd":
            self.browser.key("keyUp", key)
        self.choose("one")
        (x, y), pressed_ns = self.middle("pad-left"), time.monotonic_ns()
        self.browser.touch("touchStart", (x, y))
        self.browser.touch("touchMove", (x + 40, y - 40))
        self.car.chip.wait_for(0, lambda counts: counts > CENTER, pressed_ns, WITHIN_S)
        self.car.chip.wait_for(1, lambda counts: counts > ESC_NEUTRAL, pressed_ns, WITHIN_S)
        self.choose("left")  # with the thumb still down
        self.stands(pressed_ns)
        self.browser.touch("touchEnd")
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
                eventually(lambda: self.text("who") == "Touch to drive", "the state at rest", WITHIN_S)
        self.assertEqual(self.browser.complaints, [])
        self.assertEqual([url for url in self.browser.requests if not url.startswith((self.url, "ws:"))], [])


if __name__ == "__main__":
    rospy.init_node("phone_test")
    rostest.rosrun("car_interface", "phone_test", "__main__")
