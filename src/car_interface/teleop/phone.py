"""Decides what phones may do to the car: who drives, whether his touch counts, and the emergency stop.

Consumes what happens on connections, each with its arrival on the monotonic clock, and answers with messages to send
(``teleop.phone_messages``), the driver's controls, the e-stop, and the commands that the node is to execute. It never
raises for anything that a page sends.

A connection proves nothing: it outlives a phone that is frozen, locked or out of range, and buffers what was sent
meanwhile. So each page gets a changing token 20 times a second, and what it sends counts by the age of the token that
it echoes. A burst after a pause, and a recorded stream, echo old tokens. After each loss, load or change of the driver
the page must report that nothing is touched, and then a touch.
"""
from __future__ import annotations

import hmac
import secrets
from collections import Counter, OrderedDict, deque
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, NamedTuple

from car_interface.common.causes import AUTONOMOUS, MANUAL
from car_interface.common.rate_timer import RateTimer
from car_interface.common.units import NS_PER_S
from car_interface.teleop.keyboard import Controls
from car_interface.teleop.phone_messages import DRIVERS, NOTHING, parse, text_of

TOKEN_HZ = 20
TICKS_PER_STATUS = 4
# How old an echoed token may be. A round trip of 100 ± 50 ms and the 50 ms until the next token leave 50 ms. If this
# node dies then, teleop_logi takes another 250 ms and a tick of 20: the car is neutral 0.55 s after the last echo.
MAX_AGE_NS = NS_PER_S // 4
ABSENT_NS = 5 * NS_PER_S  # without an echo of the driver's, before another page may take his seat
MAX_PAGES = 8  # that are admitted
MAX_WAITING, WAIT_NS = 8, 5 * NS_PER_S  # connections that have not been admitted yet, and for how long
MAX_KEYS, MAX_ADDRESSES = 64, 256  # that are remembered
OTHERS = ""  # as an address: all that are more than these
# A page sends an echo for each token and, as long as a thumb moves, one for each frame of its display (60 Hz, or 120).
MESSAGES_HZ, MESSAGES_AT_ONCE = 150, 150
MAX_MALFORMED = 20  # of a connection, before it is closed
# Of an address: five guesses at once, then one in 10 s: 1e6 PINs take 116 days; by all addresses together 11 hours.
GUESSES_HZ, GUESSES_AT_ONCE = 0.1, 5
MAX_COMMANDS = 8  # that the node hasn't taken yet
GUESTS = frozenset({"e_stop", "echo", "leave"})  # what a page without the PIN may send
LET_GO = "lift your thumbs, then touch again"
REPLACED = "replaced"


class Outgoing(NamedTuple):
    """What to do on a connection: send a text, and close it after that."""

    connection: int
    text: str
    closes: bool = False


class Bucket:
    """Limits a rate: each event takes one of ``capacity``, which come back at ``rate_hz``."""

    def __init__(self, rate_hz: float, capacity: int, now_ns: int):
        self._rate_hz, self._capacity = rate_hz, capacity
        self._level, self._at_ns = float(capacity), now_ns

    def has_any(self, now_ns: int) -> bool:
        """Return whether an event is allowed."""
        refill = max(0, now_ns - self._at_ns) * self._rate_hz / NS_PER_S
        self._level, self._at_ns = min(self._capacity, self._level + refill), max(now_ns, self._at_ns)
        return self._level >= 1

    def is_full(self, now_ns: int) -> bool:
        """Return whether all that were taken came back."""
        self.has_any(now_ns)
        return self._level >= self._capacity

    def take(self, now_ns: int) -> bool:
        """Return whether an event is allowed, and count it if so."""
        is_allowed = self.has_any(now_ns)
        self._level -= is_allowed
        return is_allowed


@dataclass
class _Page:
    connection: int
    address: str
    opened_ns: int
    rate: Bucket
    key: str = ""  # empty: a guest, or not admitted
    is_guest: bool = False
    delay_ns: int | None = None  # from a token to its newest echo
    tokens: deque = field(default_factory=lambda: deque(maxlen=TOKEN_HZ))  # of a second, with their times
    number: int = -1  # of the newest message that counted
    malformed: int = 0

    @property
    def is_admitted(self) -> bool:
        return bool(self.key) or self.is_guest


class Phones:
    """All pages of one car.

    Args:
        pin: six digits, which admit a page.
        admits_guests: pages that don't know the PIN may see the car, and stop it.
        e_stop: it is on at the start.
        make_secret: returns a text that nobody can guess; for tokens and keys.
    """

    def __init__(self, pin: str, now_ns: int, admits_guests: bool = False, e_stop: bool = False,
                 make_secret: Callable[[], str] = lambda: secrets.token_urlsafe(16)):
        self._pin, self._admits_guests, self._make_secret = pin, admits_guests, make_secret
        self._timer = RateTimer(TOKEN_HZ, now_ns)
        self._pages: dict[int, _Page] = {}
        self._keys: OrderedDict[str, None] = OrderedDict()  # of admitted pages, the oldest first
        self._guesses: dict[str, Bucket] = {}  # by address
        self._outgoing: list[Outgoing] = []
        self._commands: list[tuple[int, dict[str, Any]]] = []
        self._car: dict[str, Any] = {}  # its state, by group
        self._changed: set[str] = set()  # groups that were not sent since
        self._driver: int | None = None  # his connection; None: none, or it is lost
        self._driver_key = ""  # empty: nobody has the seat
        self._driver_seen_ns = now_ns
        self._touch = Controls()
        self._fresh_until_ns = now_ns
        self._must_release = True
        self.e_stop = e_stop
        self._stopped_ns = now_ns  # when somebody last pressed it
        self.counts: Counter[str] = Counter()  # how often what happened: "malformed", "stale", "wrong PIN", "loss" …

    @property
    def due_ns(self) -> int:
        """Return when ``step`` is due: for the next token, or as the driver's echo gets too old."""
        return self._timer.due_ns if self._must_release else min(self._timer.due_ns, self._fresh_until_ns)

    @property
    def pages(self) -> int:
        return sum(page.is_admitted for page in self._pages.values())

    def controls(self, now_ns: int) -> Controls:
        """Return what the driver asks for; nothing is held unless his touch counts at ``now_ns``."""
        self._look_for_loss(now_ns)
        return Controls() if self.e_stop or self._must_release else self._touch

    def show(self, groups: Mapping[str, Any]) -> None:
        """Have all pages show groups of the car's state, as JSON has them."""
        for group, state in groups.items():
            if group not in self._car or self._car[group] != state:
                self._car[group] = state
                self._changed.add(group)

    def take_commands(self) -> list[tuple[int, dict[str, Any]]]:
        """Remove and return what pages want the node to do, in order: each one's connection and message."""
        commands, self._commands = self._commands, []
        return commands

    def answer(self, connection: int, **fields: str) -> None:
        """Send a page what became of its command: ``done``, ``refused`` or ``file``."""
        page = self._pages.get(connection)
        if page is not None:
            self._send(page, **fields)

    def drain(self) -> list[Outgoing]:
        """Remove and return what is to be sent, in order."""
        outgoing, self._outgoing = self._outgoing, []
        return outgoing

    def step(self, now_ns: int) -> int:
        """Look for a loss, and send what is due; return the number of this tick, from 1 on, or 0: none was due."""
        self._look_for_loss(now_ns)
        if not self._timer.is_due(now_ns):
            return 0
        for page in list(self._pages.values()):
            if page.is_admitted:
                page.tokens.append((self._make_secret(), now_ns))
                self._send(page, token=page.tokens[-1][0])
            elif now_ns - page.opened_ns >= WAIT_NS:
                self._close(page, "no PIN came")
        if self._timer.ticks % TICKS_PER_STATUS == 0:
            self._send_status()
            self._send_car()
        return self._timer.ticks

    # --- connections ---

    def connect(self, connection: int, address: str, now_ns: int) -> None:
        """Take a new connection. It is admitted by its first message; of too many that wait the oldest is closed."""
        waiting = [page for page in self._pages.values() if not page.is_admitted]
        if len(waiting) >= MAX_WAITING:
            self.counts["too many connections"] += 1
            self._close(waiting[0], "too many others wait to be admitted")
        self._pages[connection] = _Page(connection, address, now_ns, Bucket(MESSAGES_HZ, MESSAGES_AT_ONCE, now_ns))

    def disconnect(self, connection: int) -> None:
        """Take note that a connection is gone; a driver's seat stays his for a while."""
        self._pages.pop(connection, None)
        if connection == self._driver:
            self._driver = None
            self._release()

    def mark_stale(self) -> None:
        """Take note that messages were dropped: nothing is known of any connection, so all begin anew."""
        for page in list(self._pages.values()):
            self._close(page, "messages were dropped")

    def receive(self, connection: int, data: Any, now_ns: int) -> None:
        """Take a page's message, whatever it is."""
        self._look_for_loss(now_ns)
        page = self._pages.get(connection)
        if page is None:  # it is closed, or its beginning was dropped
            self._outgoing.append(Outgoing(connection, text_of(closed="unknown connection"), True))
            return
        if not page.rate.take(now_ns):
            self.counts["too many messages"] += 1
            self._close(page, "too many messages")
            return
        message = parse(data)
        if message is None:
            self._count_malformed(page)
        elif message["type"] in ("pin", "key", "watch"):
            getattr(self, f"_on_{message['type']}")(page, message, now_ns)
        elif not page.key and not (page.is_guest and message["type"] in GUESTS):
            self._refuse(page, "enter the PIN first")
        elif message["type"] in DRIVERS:
            self._on_drivers_command(page, message, now_ns)
        else:
            getattr(self, f"_on_{message['type']}")(page, message, now_ns)

    # --- who may ---

    def _on_pin(self, page, message, now_ns):
        guesses = self._guesses_of(page.address, now_ns)
        if not guesses.has_any(now_ns):
            self.counts["guess refused"] += 1
            self._refuse(page, "too many wrong PINs from this address: wait 10 s")
        elif not hmac.compare_digest(message["pin"], self._pin):
            guesses.take(now_ns)
            self.counts["wrong PIN"] += 1
            self._refuse(page, "wrong PIN")
        else:
            self._admit(page, self._make_secret())

    def _guesses_of(self, address, now_ns):
        """Return the guesses of an address. One that were forgotten for others could guess anew, so they share."""
        if address not in self._guesses and len(self._guesses) >= MAX_ADDRESSES:
            self._guesses = {each: guesses for each, guesses in self._guesses.items() if not guesses.is_full(now_ns)}
            if len(self._guesses) >= MAX_ADDRESSES:
                address = OTHERS
        return self._guesses.setdefault(address, Bucket(GUESSES_HZ, GUESSES_AT_ONCE, now_ns))

    def _on_key(self, page, message, now_ns):
        """Admit by key, which no guess finds: whoever guesses PINs at the driver's address does not lock him out."""
        if message["key"] not in self._keys:
            self._refuse(page, "enter the PIN")
            return
        same = [each for each in self._pages.values() if each.key == message["key"]]
        if any(each.connection > page.connection for each in same):
            self._close(page, REPLACED)  # the page has given it up, and what it had sent comes late
            return
        for other in same:
            if other is not page:
                self._close(other, REPLACED)
        self._admit(page, message["key"])

    def _on_watch(self, page, message, now_ns):
        """Admit a guest, who has the seat by no key, and leaves its place to who knows the PIN."""
        if not self._admits_guests:
            self._refuse(page, "enter the PIN")
        elif not page.is_admitted and self._has_room(page):
            page.is_guest = True
            self._greet(page)

    def _has_room(self, page):
        """Return whether one more page is admitted; a guest makes room for a page that isn't one."""
        if self.pages - page.is_admitted < MAX_PAGES:
            return True
        self.counts["too many pages"] += 1
        self._close(page, f"{MAX_PAGES} pages are open already")
        return False

    def _admit(self, page, key):
        guest = next((each for each in self._pages.values() if each.is_guest and each is not page), None)
        if guest is not None and self.pages - page.is_admitted >= MAX_PAGES:
            self._close(guest, "this place went to a phone with the PIN")
        if key != self._driver_key and not self._has_room(page):
            return
        if page.connection == self._driver and key != self._driver_key:
            self._leave()
        page.key, page.is_guest = key, False
        self._keys[key] = None
        self._keys.move_to_end(key)
        kept = {self._driver_key, *(each.key for each in self._pages.values())}
        if len(self._keys) > MAX_KEYS:
            del self._keys[next(old for old in self._keys if old not in kept)]
        self._send(page, key=key)
        self._greet(page)

    def _greet(self, page):
        self._send_status()
        self._send(page, car=self._car)

    # --- who drives ---

    def _on_drive(self, page, message, now_ns):
        if self._issued_ns(page, message, now_ns) is None:
            return
        if self._driver_key not in ("", page.key) and now_ns - self._driver_seen_ns < ABSENT_NS:
            self._refuse(page, "another phone drives: it has to leave, or to be away for 5 s")
            return
        self._driver, self._driver_key, self._driver_seen_ns = page.connection, page.key, now_ns
        self._release()
        self._send_status()

    def _on_leave(self, page, message, now_ns):
        if page.connection == self._driver:
            self._leave()
            self._send_status()

    def _leave(self):
        self._driver, self._driver_key = None, ""
        self._release()

    def _on_echo(self, page, message, now_ns):
        issued_ns = self._issued_ns(page, message, now_ns)
        if issued_ns is None or page.connection != self._driver:
            return
        touch = message["touch"]
        self._driver_seen_ns, self._fresh_until_ns = now_ns, issued_ns + MAX_AGE_NS
        self._touch = (Controls(scale=message["scale"]) if touch == NOTHING else
                       Controls(float(message["steering"]), float(message["throttle"]), touch == MANUAL,
                                touch == AUTONOMOUS, message["scale"]))
        if touch == NOTHING:
            self._must_release = False

    def _issued_ns(self, page, message, now_ns):
        """Return when a message's token was sent; None, and count it, unless that and the message are fresh."""
        issued_ns = dict(page.tokens).get(message["token"])
        if issued_ns is None or now_ns - issued_ns >= MAX_AGE_NS or message["n"] <= page.number:
            self.counts["stale"] += 1
            return None
        page.number, page.delay_ns = message["n"], now_ns - issued_ns
        return issued_ns

    def _look_for_loss(self, now_ns):
        if not self._must_release and now_ns >= self._fresh_until_ns:
            self.counts["loss"] += 1
            self._release()

    def _release(self):
        self._touch, self._must_release = Controls(), True

    # --- emergency stop ---

    def _on_e_stop(self, page, message, now_ns):
        self.e_stop, self._stopped_ns = True, now_ns
        self._release()
        self._send_status()

    def _on_clear(self, page, message, now_ns):
        issued_ns = self._issued_ns(page, message, now_ns)
        if issued_ns is None:
            return
        if page.connection != self._driver:
            self._refuse(page, "only the driver can clear the stop")
            return
        if issued_ns <= self._stopped_ns:  # it was sent for an earlier stop
            self._refuse(page, "STOP was pressed again: clear it once more")
            return
        self.e_stop = False
        self._release()
        self._send_status()

    # --- what the node does for a page ---

    def _on_drivers_command(self, page, message, now_ns):
        if self._issued_ns(page, message, now_ns) is None:
            return
        if page.connection != self._driver:
            self._refuse(page, "only the driver may do that")
        else:
            self._command(page, message)

    def _on_open(self, page, message, now_ns):
        self._command(page, message)

    def _command(self, page, message):
        if len(self._commands) >= MAX_COMMANDS:
            self._refuse(page, "too many commands at once")
        else:
            self._commands.append((page.connection, message))

    # --- messages out ---

    def _count_malformed(self, page):
        self.counts["malformed"] += 1
        page.malformed += 1
        if page.malformed > MAX_MALFORMED:
            self._close(page, "too many malformed messages")

    def _send(self, page, **fields):
        self._outgoing.append(Outgoing(page.connection, text_of(**fields)))

    def _refuse(self, page, why):
        self._send(page, refused=why)

    def _close(self, page, why):
        self._outgoing.append(Outgoing(page.connection, text_of(closed=why), True))
        self.disconnect(page.connection)

    def _send_status(self):
        why = "the e-stop is on: clear it" if self.e_stop else LET_GO if self._must_release else ""
        for page in self._pages.values():
            if page.is_admitted:
                is_free = self._driver_key in ("", page.key)  # it is this page's own after a pause of the network
                role = "you" if page.connection == self._driver else "nobody" if is_free else "another"
                delay = None if page.delay_ns is None else round(page.delay_ns / NS_PER_S, 3)
                self._send(page, status={"driver": role, "guest": page.is_guest, "e_stop": self.e_stop,
                                         "why": why if role == "you" else "", "delay": delay})

    def _send_car(self):
        changed = {group: self._car[group] for group in sorted(self._changed)}
        self._changed.clear()
        if changed:
            text = text_of(car=changed)
            self._outgoing += [Outgoing(page.connection, text) for page in self._pages.values() if page.is_admitted]
