"""What phones may do to the car: whose touch counts, and for how long. Time is passed in; nothing is sent anywhere."""
import itertools
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from car_interface.teleop.keyboard import Controls
from car_interface.teleop.phone import Bucket, Phones
from car_interface.teleop.phone_messages import number as sent_number
from car_interface.teleop.phone_messages import parse

MS = 1_000_000
S = 1000 * MS
START = 1000 * S
ABSENT_MS, WAIT_MS = 5000, 5000
GUESSES_AT_ONCE, MAX_ADDRESSES, MAX_KEYS, MAX_COMMANDS = 5, 256, 64, 8
MAX_PAGES, MAX_WAITING, MAX_MALFORMED, MESSAGES_AT_ONCE = 8, 8, 20, 150
PIN = "012345"
NOTHING_HELD = Controls()
AHEAD = Controls(0.5, 0.25, manual=True)


class Bench:
    """Phones on a clock, and a server of texts that arrive at once."""

    def __init__(self, **settings):
        secrets = map("secret {}".format, itertools.count())
        self.now_ns = START
        self.phones = Phones(PIN, START, make_secret=lambda: next(secrets), **settings)
        self.pages = {}

    def open(self, number, address="10.0.0.1"):
        page = self.pages[number] = Page(self, number)
        self.phones.connect(number, address, self.now_ns)
        return page

    def join(self, number, address="10.0.0.1"):
        page = self.open(number, address)
        page.send(type="pin", pin=PIN)
        self.wait(100)
        return page

    def reload(self, number, key):
        page = self.open(number)
        page.send(type="key", key=key)
        return page

    def drive(self, number=1):
        """Join, take the seat, let go, touch."""
        page = self.join(number)
        page.send(type="drive")
        page.touch_anew()
        return page

    def deliver(self):
        for outgoing in self.phones.drain():
            page = self.pages.get(outgoing.connection)
            if page is not None:
                page.receive(json.loads(outgoing.text), outgoing.closes)

    def wait(self, duration_ms, *echoing):
        """Let time pass; the pages that echo answer each token."""
        for _ in range(duration_ms):
            self.now_ns += MS
            before = [page.token for page in echoing]
            self.phones.step(self.now_ns)
            self.deliver()
            for page, token in zip(echoing, before):
                if page.token != token:
                    page.echo(page.touch)

    @property
    def controls(self):
        return self.phones.controls(self.now_ns)


class Page:
    """An honest page, but for what a test sends by hand."""

    def __init__(self, bench, number):
        self._bench, self.number = bench, number
        self.token = self.key = self.closed = ""
        self.refused, self.status, self.sent, self.car = [], {}, [], []
        self.n, self.touch = 0, ""

    def receive(self, message, closes):
        self.token, self.key = message.get("token", self.token), message.get("key", self.key)
        self.refused += [message["refused"]] if "refused" in message else []
        self.closed = message.get("closed", self.closed)
        self.status = message.get("status", self.status)
        self.car += [message["car"]] if "car" in message else []
        assert closes == ("closed" in message)

    def send(self, **message):
        if message["type"] in ("drive", "clear", "echo", "record", "trim", "save", "calibrate"):
            self.n += 1
            message = {"token": self.token, "n": self.n, **message}
        self.send_text(json.dumps(message))

    def send_text(self, text):
        self.sent.append(text)
        self._bench.phones.receive(self.number, text, self._bench.now_ns)
        self._bench.deliver()

    def echo(self, touch, steering=0.5, throttle=0.25, **more):
        self.touch = touch
        self.send(type="echo", touch=touch, steering=steering, throttle=throttle, scale=0, **more)

    def touch_anew(self, *sticks):
        self.echo("")
        self.echo("manual", *sticks)


@pytest.fixture
def bench():
    return Bench()


# --- fresh evidence ---

@pytest.mark.parametrize("age_ms", [0, 100, 200, 240])
def test_echo_counts_by_the_age_of_its_token_and_not_from_its_arrival(bench, age_ms):
    page = bench.drive()
    while page.token in page.sent[-1]:
        bench.wait(1)
    issued_ns, token = bench.now_ns, page.token
    bench.wait(age_ms, page)
    page.echo("manual", token=token)
    assert bench.phones.controls(issued_ns + 250 * MS - 1) == AHEAD
    assert bench.phones.controls(issued_ns + 250 * MS) == NOTHING_HELD
    assert bench.phones.counts["loss"] == 1 and page.closed == ""


def test_step_is_due_in_the_moment_in_which_the_touch_gets_too_old(bench):
    bench.drive()
    while bench.controls != NOTHING_HELD:
        bench.now_ns = bench.phones.due_ns
        before = bench.phones.controls(bench.now_ns - 1)
        bench.phones.step(bench.now_ns)
    assert before == AHEAD


@pytest.mark.parametrize("round_trip_ms", [0, 50, 100, 150])
def test_car_drives_on_without_a_gap_at_a_round_trip_of_up_to_150_ms(bench, round_trip_ms):
    page = bench.drive()
    under_way = []
    for _ in range(3000):
        bench.now_ns += MS
        token = page.token
        bench.phones.step(bench.now_ns)
        bench.deliver()
        if page.token != token:
            under_way.append((bench.now_ns + round_trip_ms * MS, page.token))
        if under_way and under_way[0][0] <= bench.now_ns:
            page.echo("manual", token=under_way.pop(0)[1])
        assert bench.controls == AHEAD


@pytest.mark.parametrize("pause_ms", [250, 300, 1000, 60_000])
def test_burst_of_what_was_touched_in_a_pause_grants_nothing(bench, pause_ms):
    page = bench.drive()
    late = [page.token]
    for _ in range(pause_ms):
        bench.now_ns += MS
        bench.phones.step(bench.now_ns)
        late += [message.text for message in bench.phones.drain() if "token" in message.text][:1]
    tokens = [late[0], *(json.loads(text)["token"] for text in late[1:])]
    for token in tokens[-100:]:  # all at once, as a socket that was held up delivers them
        page.echo("manual", token=token)
        assert bench.controls == NOTHING_HELD
    bench.wait(500, page)
    assert bench.controls == NOTHING_HELD and page.status["why"] == "lift your thumbs, then touch again"
    page.touch_anew()
    assert bench.controls == AHEAD


def test_recorded_stream_counts_neither_on_its_connection_nor_on_another_one(bench):
    page = bench.drive()
    page.touch = "manual"
    bench.wait(1000, page)
    recorded = list(page.sent)[1:]  # without the PIN
    page.echo("")
    other = bench.join(2)
    stale = bench.phones.counts["stale"]
    for number in (1, 2):
        for text in recorded:
            bench.pages[number].send_text(text)
            assert bench.controls == NOTHING_HELD
    assert bench.phones.counts["stale"] - stale == 2 * len(recorded) > 40 and other.status["driver"] == "another"


def test_echo_that_arrives_twice_counts_once_also_while_its_token_is_fresh(bench):
    page = bench.drive()
    touched = page.sent[-1]
    page.echo("")
    page.send_text(touched)
    assert bench.controls == NOTHING_HELD


@pytest.mark.parametrize("lost", range(12))
def test_pause_of_the_echoes_at_any_phase_ends_the_touch_until_it_was_let_go(bench, lost):
    page = bench.drive()
    bench.wait(200 + 7 * lost, page)
    assert bench.controls == AHEAD
    bench.wait(250)
    assert bench.controls == NOTHING_HELD
    bench.wait(500, page)
    assert bench.controls == NOTHING_HELD
    page.echo("")
    assert bench.controls == NOTHING_HELD
    page.echo("manual")
    assert bench.controls == AHEAD


def test_touch_that_was_there_when_the_page_was_loaded_counts_after_it_was_let_go(bench):
    page = bench.join(1)
    page.send(type="drive")
    page.touch = "manual"
    bench.wait(1000, page)
    assert bench.controls == NOTHING_HELD
    page.echo("")
    page.echo("autonomous", 0.0, 0.0)
    assert bench.controls == Controls(autonomous=True)


def test_driver_who_asks_to_drive_again_has_to_let_go(bench):
    page = bench.drive()
    page.send(type="drive")
    page.echo("manual")
    assert bench.controls == NOTHING_HELD


def test_closed_connection_releases_at_once_and_a_reload_drives_by_its_key_and_a_new_touch(bench):
    page, other = bench.drive(), bench.join(9)
    bench.phones.disconnect(1)
    assert bench.controls == NOTHING_HELD
    again = bench.reload(2, page.key)
    bench.wait(200)
    assert (again.status["driver"], other.status["driver"]) == ("nobody", "another")
    again.echo("manual")
    assert bench.controls == NOTHING_HELD
    again.send(type="drive")  # its seat: it waits for nobody's absence
    again.echo("manual")
    assert bench.controls == NOTHING_HELD
    again.touch_anew()
    assert bench.controls == AHEAD


def test_another_page_s_connection_of_the_same_number_is_not_the_driver_s(bench):
    bench.drive(1)
    bench.phones.disconnect(1)
    page = bench.join(1)
    page.echo("")
    page.echo("manual")
    assert bench.controls == NOTHING_HELD and page.status["driver"] == "another"


def test_message_of_a_connection_that_is_not_known_closes_it(bench):
    bench.phones.receive(77, "{}", bench.now_ns)
    assert bench.phones.drain() == [(77, '{"closed":"unknown connection"}', True)]


def test_echo_that_comes_after_a_loss_which_nobody_has_seen_yet_does_not_hide_it(bench):
    page = bench.drive()
    bench.wait(50)
    page.echo("manual")
    bench.wait(200)  # a newer token, and no echo
    bench.now_ns += 50 * MS
    page.echo("manual")
    assert bench.controls == NOTHING_HELD and bench.phones.counts["loss"] == 1


def test_dropped_messages_release_and_have_each_page_connect_again(bench):
    pages = [bench.drive(1), bench.join(2)]
    bench.phones.mark_stale()
    bench.deliver()
    assert bench.controls == NOTHING_HELD
    assert [page.closed for page in pages] == ["messages were dropped"] * 2


@pytest.mark.parametrize("later_ns, closed", [(6_640_000, "too many messages"), (6_670_000, "")])  # 1 s / 150
def test_page_sends_150_messages_at_once_and_as_many_a_second(bench, later_ns, closed):
    page = bench.open(1)
    for _ in range(MESSAGES_AT_ONCE):
        page.send(type="leave")
    assert not page.closed
    bench.now_ns += later_ns
    page.send(type="leave")
    assert page.closed == closed and bench.phones.counts["too many messages"] == bool(closed)


def test_tokens_are_sent_20_times_a_second_and_the_state_5_times(bench):
    page, sent = bench.join(1), []
    page.receive = lambda message, closes: sent.extend(message)
    for number in range(1000):
        bench.phones.show({"speed": number})
        bench.wait(1)
    assert [sent.count(name) for name in ("token", "status", "car")] == [20, 5, 5]
    assert sent[:5] == ["token", "status", "car", "token", "token"]  # after three ticks while it joined


def test_step_is_due_between_two_tokens_where_the_touch_gets_too_old_then(bench):
    page = bench.drive()
    bench.now_ns = issued_ns = bench.phones.due_ns + 3 * MS  # it was late
    bench.phones.step(issued_ns)
    bench.deliver()
    page.echo("manual")
    due = []
    for _ in range(7):
        due.append((bench.phones.due_ns - issued_ns) // MS)
        bench.phones.step(bench.phones.due_ns)
    assert due == [47, 97, 147, 197, 247, 250, 297]


def test_bucket_gets_back_what_was_taken_as_time_passes_and_no_more_than_it_holds():
    bucket = Bucket(1e9, 2, START)  # one each nanosecond
    assert bucket.is_full(START) and bucket.take(START) and bucket.take(START)
    for now_ns, is_allowed in ((START, False), (START - 9, False), (START, False), (START + 1, True)):
        assert bucket.has_any(now_ns) == is_allowed
    assert not bucket.is_full(START + 1) and bucket.is_full(START + 2)
    assert [bucket.take(START + 9) for _ in range(3)] == [True, True, False]


# --- one driver ---

def test_second_phone_watches_until_the_driver_leaves(bench):
    first, second = bench.drive(1), bench.join(2)
    second.send(type="drive")
    second.touch_anew(-1.0, 1.0)
    assert second.refused == ["another phone drives: it has to leave, or to be away for 5 s"]
    assert bench.controls == AHEAD
    assert (first.status["driver"], second.status["driver"]) == ("you", "another")
    first.send(type="leave")
    assert bench.controls == NOTHING_HELD and second.status["driver"] == "nobody"
    second.send(type="drive")
    assert (first.status["driver"], second.status["driver"]) == ("another", "you")
    second.touch_anew(-1.0, 1.0)
    assert bench.controls == Controls(-1.0, 1.0, manual=True)


@pytest.mark.parametrize("closes", [False, True])
def test_seat_of_a_driver_who_is_away_is_his_for_5_s(bench, closes):
    bench.drive(1)
    second = bench.join(2)
    if closes:
        bench.phones.disconnect(1)
    bench.wait(ABSENT_MS - 101, second)  # it took 100 to join
    second.send(type="drive")
    assert len(second.refused) == 1
    bench.wait(1, second)
    second.send(type="drive")
    assert len(second.refused) == 1
    second.touch_anew()
    assert bench.controls == AHEAD


def test_driver_who_comes_back_to_a_seat_that_was_taken_grants_nothing(bench):
    first, second = bench.drive(1), bench.join(2)
    bench.wait(6000, second)
    second.send(type="drive")
    first.touch_anew()
    assert bench.controls == NOTHING_HELD


# --- emergency stop ---

def test_any_page_stops_and_the_driver_s_button_and_a_new_touch_end_it(bench):
    first, second = bench.drive(1), bench.join(2)
    second.send(type="e_stop")
    assert bench.phones.e_stop and bench.controls == NOTHING_HELD
    assert first.status["why"] == "the e-stop is on: clear it"
    second.send(type="clear")
    assert bench.phones.e_stop and second.refused == ["only the driver can clear the stop"]
    first.touch_anew()
    assert bench.controls == NOTHING_HELD
    bench.wait(100)
    first.send(type="clear")
    assert not first.status["e_stop"] and first.status["why"] == "lift your thumbs, then touch again"
    first.echo("manual")
    assert not bench.phones.e_stop and bench.controls == NOTHING_HELD
    first.touch_anew()
    assert bench.controls == AHEAD


@pytest.mark.parametrize("delay_ms", [0, 100, 300])
def test_clear_that_was_sent_before_the_stop_or_arrives_twice_ends_nothing(bench, delay_ms):
    page = bench.drive()
    page.send(type="e_stop")
    bench.wait(100)
    page.send(type="clear")
    cleared = page.sent[-1]
    assert not bench.phones.e_stop
    page.send(type="e_stop")
    bench.wait(delay_ms)
    page.send_text(cleared)
    assert bench.phones.e_stop


def test_clear_for_one_stop_does_not_end_another_one_that_arrived_before_it(bench):
    driver, viewer = bench.drive(1), bench.join(2)
    viewer.send(type="e_stop")
    bench.wait(100)
    viewer.send(type="e_stop")  # while the driver's answer to the first one is under way
    driver.send(type="clear")
    assert bench.phones.e_stop and driver.refused == ["STOP was pressed again: clear it once more"]
    bench.wait(100)
    driver.send(type="clear")
    assert not bench.phones.e_stop


def test_touch_that_a_stop_ended_is_no_loss(bench):
    bench.drive().send(type="e_stop")
    bench.wait(300)
    assert bench.phones.counts["loss"] == 0


def test_e_stop_outlives_every_page(bench):
    page = bench.drive()
    page.send(type="e_stop")
    bench.phones.disconnect(1)
    bench.wait(10_000)
    assert bench.phones.e_stop


# --- who may ---

@pytest.mark.parametrize("kind", ["drive", "leave", "echo", "e_stop", "clear"])
def test_nothing_counts_before_the_pin_and_no_token_is_sent(bench, kind):
    page = bench.open(1)
    bench.wait(200)
    if kind == "echo":
        page.echo("manual")
    else:
        page.send(type=kind)
    assert (page.refused, page.token, bench.phones.e_stop) == (["enter the PIN first"], "", False)


def test_page_that_is_admitted_knows_at_once_who_drives(bench):
    page = bench.open(1)
    page.send(type="pin", pin=PIN)
    assert page.key and page.status == {"driver": "nobody", "guest": False, "e_stop": False, "why": "", "delay": None}


def test_guesses_are_limited_by_address_and_neither_others_nor_the_driver_s_key_are(bench):
    driver = bench.drive(1)
    for number in range(10, 10 + GUESSES_AT_ONCE):
        bench.open(number).send(type="pin", pin="999999")
    right = bench.open(20)
    right.send(type="pin", pin=PIN)
    assert right.refused == ["too many wrong PINs from this address: wait 10 s"] and not right.key
    assert (bench.phones.counts["wrong PIN"], bench.phones.counts["guess refused"]) == (GUESSES_AT_ONCE, 1)
    assert bench.pages[10].refused == ["wrong PIN"]
    assert bench.join(21, "10.0.0.2").key
    bench.phones.disconnect(1)
    again = bench.reload(22, driver.key)
    assert again.key == driver.key
    bench.now_ns += 9_800 * MS  # and 100 as another one joined
    right.send(type="pin", pin=PIN)
    assert not right.key
    bench.now_ns += 100 * MS
    right = bench.open(23)
    right.send(type="pin", pin=PIN)
    assert right.key


@pytest.mark.more
def test_guesser_with_many_addresses_has_no_more_guesses_than_256_and_makes_nothing_grow(bench):
    for number in range(6000):
        bench.open(number, f"fd00::{number % 1000}").send(type="pin", pin="999999")
        bench.phones.disconnect(number)
    groups = MAX_ADDRESSES + 1  # and all others
    assert bench.phones.counts["wrong PIN"] == groups * GUESSES_AT_ONCE
    assert len(bench.phones._guesses) <= groups and not bench.phones._pages
    bench.now_ns += 50 * S
    page = bench.open(1, "10.0.0.1")
    page.send(type="pin", pin=PIN)
    assert page.key and len(bench.phones._guesses) == 1


def test_connections_that_send_nothing_make_room_and_disturb_no_driver(bench):
    driver = bench.drive(1)
    for number in range(100, 300):
        bench.open(number)
    bench.deliver()
    assert [number for number in range(100, 300) if not bench.pages[number].closed] == [*range(292, 300)]
    assert bench.phones.counts["too many connections"] == 192
    bench.wait(WAIT_MS - 1, driver)
    assert sum(not bench.pages[number].closed for number in range(100, 300)) == MAX_WAITING
    bench.wait(50, driver)
    assert all(bench.pages[number].closed for number in range(100, 300))
    assert bench.controls == AHEAD


def test_connection_that_is_not_admitted_is_closed_after_5_s(bench):
    page = bench.open(1)
    bench.wait(WAIT_MS - 1)
    assert not page.closed
    bench.wait(1)
    assert page.closed == "no PIN came"


def test_pages_are_limited_and_the_driver_comes_back_among_them(bench):
    driver = bench.drive(1)
    watching = [bench.join(number) for number in range(2, 2 + MAX_PAGES)]
    assert [page.closed for page in watching] == [""] * (MAX_PAGES - 1) + [f"{MAX_PAGES} pages are open already"]
    assert bench.phones.counts["too many pages"] == 1 and not watching[-1].key
    bench.phones.disconnect(1)
    bench.join(50)
    again = bench.reload(51, driver.key)
    assert again.key and not again.closed


def test_page_that_comes_again_by_its_key_replaces_the_one_that_is_still_open(bench):
    first, other = bench.drive(1), bench.join(3)
    again = bench.reload(2, first.key)
    assert first.closed == "replaced" and again.key == first.key and not other.closed and bench.phones.pages == 2


def test_what_a_page_sent_before_it_connected_anew_does_not_replace_its_newer_connection(bench):
    first = bench.drive(1)
    given_up = bench.open(2)
    again = bench.reload(3, first.key)
    given_up.send(type="key", key=first.key)
    assert given_up.closed == "replaced" and again.key == first.key and not again.closed and bench.phones.pages == 1


def test_page_that_sends_its_key_again_stays(bench):
    page = bench.join(1)
    page.send(type="key", key=page.key)
    assert not page.closed and bench.phones.pages == 1


def test_page_that_is_admitted_again_needs_no_more_room(bench):
    pages = [bench.join(number) for number in range(MAX_PAGES)]
    pages[-1].send(type="pin", pin=PIN)
    assert not any(page.closed for page in pages)


@pytest.mark.parametrize("age_ns, is_stale", [(250 * MS - 1, False), (250 * MS, True)])
def test_command_counts_while_its_token_is_younger_than_250_ms(bench, age_ns, is_stale):
    page = bench.join(1)
    bench.wait(50)
    bench.now_ns = bench.phones.due_ns - 50 * MS + age_ns
    page.send(type="drive")
    assert bench.phones.counts["stale"] == is_stale


def test_page_sees_how_late_its_echoes_come(bench):
    page = bench.drive()
    token = page.token
    while page.token == token:
        bench.wait(1)
    bench.wait(40)
    bench.now_ns += 400_000  # less than a millisecond
    page.echo("")
    bench.wait(200)
    assert page.status["delay"] == 0.04


def test_driver_s_page_that_is_admitted_by_the_pin_again_leaves_the_seat(bench):
    page = bench.drive(1)
    page.send(type="pin", pin=PIN)
    bench.wait(100)
    assert bench.controls == NOTHING_HELD and page.status["driver"] == "nobody"


def test_keys_are_limited_and_the_driver_s_is_kept(bench):
    driver, oldest = bench.drive(1), bench.join(2)
    bench.phones.disconnect(2)
    for number in range(3, 3 + MAX_KEYS):
        bench.join(number)
        bench.phones.disconnect(number)
    bench.phones.disconnect(1)
    for number, page in ((100, oldest), (101, driver)):
        again = bench.reload(number, page.key)
        assert (again.key, again.refused) == (("", ["enter the PIN"]) if page is oldest else (driver.key, []))


def test_keys_of_the_pages_that_came_last_are_kept(bench):
    first, second = bench.join(1), bench.join(2)
    bench.open(3).send(type="key", key=first.key)
    for number in range(1, 4):
        bench.phones.disconnect(number)
    for number in range(10, 9 + MAX_KEYS):
        bench.join(number)
        bench.phones.disconnect(number)
    for number, page in ((100, first), (101, second)):
        again = bench.open(number)
        again.send(type="key", key=page.key)
        assert bool(again.key) == (page is first)


def test_watcher_who_leaves_changes_nothing(bench):
    bench.drive(1)
    bench.join(2).send(type="leave")
    assert bench.phones.controls(bench.now_ns) == bench.controls != NOTHING_HELD


def test_page_that_sends_too_much_is_closed_and_what_it_held_with_it(bench):
    page = bench.drive()
    while not page.closed and len(page.sent) < 2 * MESSAGES_AT_ONCE:
        page.echo("manual")
    assert page.closed == "too many messages" and bench.controls == NOTHING_HELD


# --- guests ---

def guest(bench, number):
    page = bench.open(number)
    page.send(type="watch")
    assert page.closed or page.refused or page.status["guest"] and page.car == [{}]
    bench.wait(200)
    return page


def test_guest_sees_and_stops_and_may_do_nothing_else():
    bench = Bench(admits_guests=True)
    driver, page = bench.drive(1), guest(bench, 2)
    assert page.status["guest"] and not page.key and page.token
    for kind in ("drive", "clear", "save", "open"):
        page.send(type=kind, **({"name": "a.bag"} if kind == "open" else {}))
    assert page.refused == ["enter the PIN first"] * 4 and bench.controls == AHEAD
    assert driver.status["driver"] == "you" and bench.phones.take_commands() == []
    page.send(type="e_stop")
    assert bench.phones.e_stop


def test_guest_becomes_a_driver_by_the_pin():
    bench = Bench(admits_guests=True)
    page = guest(bench, 1)
    page.send(type="pin", pin=PIN)
    bench.wait(100)
    page.send(type="drive")
    page.touch_anew()
    assert bench.controls == AHEAD and not page.status["guest"]


def test_guest_who_enters_the_pin_keeps_its_place_and_takes_nobody_s():
    bench = Bench(admits_guests=True)
    guests = [guest(bench, number) for number in range(MAX_PAGES)]
    guests[1].send(type="pin", pin=PIN)
    assert guests[1].key and not any(page.closed for page in guests)


def test_guests_make_room_for_who_knows_the_pin_and_for_no_other_guest():
    bench = Bench(admits_guests=True)
    guests = [guest(bench, number) for number in range(MAX_PAGES + 1)]
    assert [page.closed for page in guests] == [""] * MAX_PAGES + [f"{MAX_PAGES} pages are open already"]
    assert bench.join(50).key and guests[0].closed == "this place went to a phone with the PIN"
    assert bench.phones.pages == MAX_PAGES


def test_guest_is_refused_unless_a_parameter_allows_it(bench):
    page = guest(bench, 1)
    assert (page.refused, page.token) == (["enter the PIN"], "")


# --- commands ---

COMMANDS = [{"type": "record", "on": True}, {"type": "trim", "name": "neutral", "value": 4900}, {"type": "save"},
            {"type": "calibrate", "what": "give up"}]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command["type"])
def test_command_of_the_driver_s_is_passed_on_once_and_one_of_a_watcher_s_or_an_old_one_is_not(bench, command):
    driver, watcher = bench.drive(1), bench.join(2)
    driver.send(**command)
    sent = driver.sent[-1]
    (connection, message), = bench.phones.take_commands()
    assert connection == 1 and {name: message[name] for name in command} == command
    driver.send_text(sent)
    watcher.send(**command)
    assert watcher.refused == ["only the driver may do that"]
    old = driver.token
    bench.wait(300, driver)
    driver.send(**{**command, "token": old})
    assert bench.phones.take_commands() == [] and bench.controls == AHEAD


def test_watcher_s_wish_for_a_file_is_passed_on_and_its_answer_goes_to_who_is_still_there(bench):
    watcher = bench.join(1)
    watcher.send(type="open", name="car.bag")
    (connection, message), = bench.phones.take_commands()
    bench.phones.answer(connection, file="/files/1")
    assert [json.loads(outgoing.text) for outgoing in bench.phones.drain()] == [{"file": "/files/1"}]
    bench.phones.disconnect(connection)
    bench.phones.answer(connection, file="/files/2")
    assert bench.phones.drain() == [] and message["name"] == "car.bag"


def test_answer_with_the_name_of_a_file_that_is_no_utf_8_can_be_sent(bench):
    page = bench.join(1)
    bench.phones.answer(page.number, refused="no recording: /home/\udce4")
    assert [outgoing.text.encode() for outgoing in bench.phones.drain()] == [
        b'{"refused":"no recording: /home/\\udce4"}']


def test_commands_that_the_node_has_not_taken_are_limited(bench):
    driver = bench.drive(1)
    for _ in range(MAX_COMMANDS + 1):
        driver.send(type="save")
    assert len(bench.phones.take_commands()) == MAX_COMMANDS and driver.refused == ["too many commands at once"]


def test_state_of_the_car_is_sent_as_it_changes_and_whole_to_a_new_page(bench):
    first = bench.join(1)
    bench.phones.show({"speed": 1.0, "who": {"text": "nobody"}})
    bench.wait(200)
    assert first.car == [{}, {"speed": 1.0, "who": {"text": "nobody"}}]
    bench.phones.show({"speed": 2.0, "who": {"text": "nobody"}})
    bench.wait(400)
    assert first.car[2:] == [{"speed": 2.0}]
    assert bench.join(2).car[0] == {"speed": 2.0, "who": {"text": "nobody"}}


# --- malformed messages ---

ECHO = {"type": "echo", "token": "t", "n": 1, "touch": "manual", "steering": 0.0, "throttle": 1, "scale": 0}


@pytest.mark.parametrize("text", [
    "", "{", "[]", "null", "7", '"pin"', "{}", '{"type": 7}', '{"type": ["pin"]}', '{"type": "reboot"}', "[" * 512,
    '{"type": "pin"}', '{"type": "pin", "pin": 12345}', '{"type": "pin", "pin": "١٢٣٤٥٦"}',
    '{"type": "open", "name": "../a.bag"}', '{"type": "open", "name": ".a.bag"}', '{"type": "open", "name": "a/b.bag"}',
    '{"type": "open", "name": "a.yaml"}', '{"type": "trim", "token": "t", "n": 1, "name": "left", "value": 5}',
    '{"type": "trim", "token": "t", "n": 1, "name": "center", "value": 5.0}',
    '{"type": "record", "token": "t", "n": 1, "on": 1}', '{"type": "save"}',
    '{"type": "calibrate", "token": "t", "n": 1, "what": "--output"}',
    '{"type": "pin", "pin": "12345"}', '{"type": "e_stop", "more": 1}', '{"type": "e_stop"}' + " " * 600,
    b'{"type": "e_stop"}', None,
    *(json.dumps({**ECHO, **change}) for change in (
        {"steering": 1.01}, {"throttle": -2}, {"steering": float("nan")}, {"throttle": float("inf")}, {"steering": "0"},
        {"steering": None}, {"steering": True}, {"n": 1.0}, {"n": -1}, {"n": True}, {"n": 2 ** 60}, {"touch": "both"},
        {"touch": None}, {"touch": []}, {"scale": 2}, {"scale": 0.5}, {"token": 5}, {"token": "x" * 65})),
    json.dumps(ECHO).replace('"n": 1', '"n": ' + "9" * 400), json.dumps(ECHO).replace("0.0", "1e999"),
])
def test_malformed_message_is_refused_and_counted(bench, text):
    page = bench.drive()
    assert parse(text) is None
    bench.phones.receive(1, text, bench.now_ns)
    assert bench.phones.counts["malformed"] == 1 and bench.controls == AHEAD and not page.closed


TRIM = {"type": "trim", "token": "t", "n": 1, "name": "center"}


@pytest.mark.parametrize("message, is_right", [
    *(({**ECHO, **change}, is_right) for change, is_right in (
        ({"n": 0}, True), ({"n": 2 ** 53 - 1}, True), ({"n": 2 ** 53}, False), ({"token": "x" * 64}, True),
        ({"steering": -1, "throttle": 1.0}, True), ({"scale": -1}, True), ({"scale": 1}, True), ({"scale": -2}, False),
        ({"touch": ""}, True), ({"touch": "autonomous"}, True))),
    *(({**TRIM, "value": value}, 0 <= value <= 65535) for value in (-1, 0, 65535, 65536)),
    ({"type": "key", "key": "x" * 64}, True), ({"type": "key", "key": "x" * 65}, False),
    ({"type": "open", "name": "a" * 91 + ".bag"}, True), ({"type": "open", "name": "a" * 92 + ".bag"}, False),
], ids=str)
def test_message_is_right_up_to_its_limits(message, is_right):
    assert parse(json.dumps(message)) == (message if is_right else None)


def test_message_has_at_most_512_characters():
    text = json.dumps({"type": "e_stop"})
    assert parse(text.ljust(512)) == {"type": "e_stop"} and parse(text.ljust(513)) is None


@pytest.mark.parametrize("value, sent", [
    (1.23456, 1.235), (-2.0, -2.0), (float("inf"), "inf"), (float("-inf"), "-inf"), (float("nan"), None)], ids=str)
def test_number_is_sent_as_json_has_it(value, sent):
    assert json.loads(json.dumps(sent_number(value), allow_nan=False)) == sent


def test_page_that_sends_many_malformed_messages_is_closed(bench):
    page = bench.drive()
    for _ in range(MAX_MALFORMED + 1):
        page.send_text("nonsense")
    assert page.closed == "too many malformed messages" and bench.controls == NOTHING_HELD


def test_ticks_come_each_50_ms_and_are_numbered_from_1_on():
    bench, numbers = Bench(), []
    for _ in range(200):
        bench.now_ns += MS
        numbers.append(bench.phones.step(bench.now_ns))
    assert [(at_ms, number) for at_ms, number in enumerate(numbers, 1) if number != 0] == [
        (1, 1), (50, 2), (100, 3), (150, 4), (200, 5)]


@pytest.mark.more
@settings(max_examples=300, deadline=None)
@given(st.lists(st.one_of(
    st.text(max_size=80), st.binary(max_size=20),
    st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
                 lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
                 max_leaves=8).map(json.dumps),
    st.fixed_dictionaries({name: st.sampled_from([value, None, 7, -1, "", "manual", [], {}, 1e9])
                           for name, value in ECHO.items()}).map(json.dumps)), max_size=30))
def test_nothing_that_a_page_sends_raises_or_grants(texts):
    bench = Bench()
    bench.join(1).send(type="drive")
    for text in texts:
        bench.phones.receive(1, text, bench.now_ns)
        bench.phones.step(bench.now_ns)
    assert bench.controls == NOTHING_HELD and not bench.phones.e_stop
