"""The page in a real browser, with a test in the node's place: what it sends when events are lost, late or missing."""
import json
import queue
import time

import pytest

pytest.importorskip("tornado")

from browser import Browser, find_browser
from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.nodes.phone_drive.server import Server
from car_interface.teleop.phone import Outgoing
from nodes.phone_drive.test_server import Node, port  # noqa: F401 - a fixture

pytestmark = [pytest.mark.once, pytest.mark.browser]
WITHIN_S = 60
STATUS = {"driver": "you", "guest": False, "e_stop": False, "why": "", "delay": 0.01}
KEY = "document.body.dispatchEvent(new KeyboardEvent('%s', {key: '%s', code: '%s', bubbles: true, cancelable: true}))"


class Car:
    """What the page is connected to. Each message of the page's is taken by ``next``, or skipped by ``touch``."""

    def __init__(self, at_port):
        self.node = Node()
        self.server = Server(PhoneDriveConfig(port=at_port), self.node, self.node)
        self._tokens = 0

    def send(self, **fields):
        self.server.send(Outgoing(self.number, json.dumps(fields), "closed" in fields))

    def next(self, *kinds, within_s=WITHIN_S):
        """Return the next message of one of these types; None: none came in time."""
        end_s = time.monotonic() + within_s
        while time.monotonic() < end_s:
            try:
                what, *event = self.node.events.get(timeout=max(0, end_s - time.monotonic()))
            except queue.Empty:
                break
            if what == "connect":
                self.number = event[0]
            elif what == "message" and (message := json.loads(event[1]))["type"] in kinds:
                return message
        return None

    def admit(self, kind, key, **status):
        """Let the page in, as the driver's."""
        message = self.next(kind)
        self.send(key=key)
        self.send(status={**STATUS, **status})
        return message

    def touch(self):
        """Return what the page answers to a new token: what is touched now.

        A page that has heard nothing for 1.5 s, as the computer stood still, connects anew first.
        """
        self._tokens += 1
        token = f"token {self._tokens}"
        self.send(token=token)
        while (message := self.next("echo", "key")).get("token") != token:
            if message["type"] == "key":
                self.send(key="k")
                self.send(status=STATUS)
                self.send(token=token)
        return message["touch"]


@pytest.fixture(scope="module")
def browser():
    with Browser(find_browser() or pytest.skip("there is no Chromium")) as browser:
        yield browser


@pytest.fixture
def car(browser, port):  # noqa: F811 - the fixture of this name
    car = Car(port)
    browser.open(f"http://127.0.0.1:{port}/#271828")
    assert car.admit("pin", "k")["pin"] == "271828"
    assert car.touch() == ""
    yield car
    car.server.stop()


def test_key_that_stayed_down_while_another_window_had_the_keys_counts_after_it_came_up(browser, car):
    browser.evaluate(KEY % ("keydown", "m", "KeyM"))
    assert car.touch() == "manual"
    browser.evaluate("dispatchEvent(new Event('blur'))")
    assert car.touch() == ""
    browser.evaluate(KEY % ("keydown", "m", "KeyM"))  # a repeat that isn't marked as one
    assert car.touch() == ""
    browser.evaluate(KEY % ("keyup", "m", "KeyM"))
    browser.evaluate(KEY % ("keydown", "m", "KeyM"))
    assert car.touch() == "manual"


@pytest.mark.parametrize("name", ["pad-left", "pad-right"])
def test_thumb_whose_end_was_lost_is_released_when_no_finger_touches_the_screen(browser, car, name):
    browser.evaluate(f"document.getElementById('{name}').dispatchEvent("
                     "new PointerEvent('pointerdown', {pointerId: 7, pointerType: 'touch', bubbles: true}))")
    assert car.touch() == "manual"
    browser.evaluate("document.body.dispatchEvent(Object.assign(new Event('touchend', {bubbles: true}),"
                     " {touches: [1]}))")
    assert car.touch() == "manual"
    browser.evaluate("document.body.dispatchEvent(Object.assign(new Event('touchend', {bubbles: true}),"
                     " {touches: []}))")
    assert car.touch() == ""


def test_pen_that_hovers_after_its_end_was_lost_is_released(browser, car):
    for event in ("'pointerdown', {buttons: 1, ", "'pointermove', {buttons: 0, "):
        browser.evaluate(f"document.getElementById('pad-left').dispatchEvent(new PointerEvent({event}"
                         "pointerId: 7, pointerType: 'pen', bubbles: true}))")
    assert car.touch() == ""


def test_space_bar_lets_go_and_clicks_no_button_that_has_the_focus(browser, car):
    browser.evaluate(KEY % ("keydown", "m", "KeyM"))
    assert [browser.evaluate(KEY % (kind, " ", "Space")) for kind in ("keydown", "keyup")] == [False, False]
    assert car.touch() == ""


def test_page_that_nobody_sees_answers_no_token_also_where_no_event_says_so(browser, car):
    browser.evaluate("Object.defineProperty(document, 'visibilityState', {value: 'hidden', configurable: true})")
    car.send(token="unseen")
    assert car.next("echo", within_s=1) is None
    browser.evaluate("delete document.visibilityState")
    assert car.touch() == ""


ADMISSIONS = {"same_node": {"key": "k"}, "new_node": {"key": "other"}, "guest": {"status": {**STATUS, "guest": True}}}


@pytest.mark.parametrize("admission", ADMISSIONS.values(), ids=ADMISSIONS)
def test_stop_that_was_shown_may_be_cleared_by_now_and_is_not_sent_again(browser, car, admission):
    car.send(status={**STATUS, "e_stop": True})
    car.touch()
    car.send(closed="messages were dropped")
    assert car.next("key")["key"] == "k"
    car.send(**admission)
    assert car.next("e_stop", within_s=0.5) is None


@pytest.mark.parametrize("admission", ADMISSIONS.values(), ids=ADMISSIONS)
def test_stop_that_was_pressed_without_contact_is_sent_once_there_is_one_and_forgotten_by_a_reload(
        browser, car, admission):
    car.send(closed="messages were dropped")
    assert car.next("key")["key"] == "k"
    browser.evaluate("document.getElementById('stop').dispatchEvent(new PointerEvent('pointerdown', {bubbles: true}))")
    car.send(**admission)
    assert car.next("e_stop")
    browser.reload()
    car.next("key")
    car.send(**admission)
    assert car.next("e_stop", within_s=0.5) is None


@pytest.mark.parametrize("driver, guest, next_step", [
    ("you", False, "Clear it, then touch again."), ("nobody", False, "Press Drive, then clear it."),
    ("another", False, "Only the driver's phone can clear it."),
    ("nobody", True, "Only the driver's phone can clear it."),
])
def test_who_sees_an_emergency_stop_reads_what_ends_it(browser, car, driver, guest, next_step):
    car.send(status={**STATUS, "driver": driver, "guest": guest, "e_stop": True})
    car.touch()
    assert browser.evaluate("document.getElementById('why').textContent") == next_step


def test_pin_is_taken_out_of_the_address_also_of_a_tab_that_was_open(browser, car):
    car.send(closed="messages were dropped")
    car.next("key")
    car.send(refused="enter the PIN")
    browser.evaluate("location.hash = '#314159'")
    assert car.next("pin")["pin"] == "314159"
    assert browser.evaluate("location.hash") == ""
