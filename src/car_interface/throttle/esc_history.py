"""What pulses the ESC has had, as far as that is known, and what it makes of the next pull because of them.

Two accounts are kept: what the servo board held (``/servo/output``: also what a guard or a timeout put there), and what
was sent, which the board may hold by now without having said so. Whatever *forbids* something counts from either;
whatever *permits* something must stand in both.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import EscConfig

# A duty is rounded to counts of 16, and there are about 1640 from neutral to an end: half a count is 0.005.
NEUTRAL_TOLERANCE = 0.01
# /servo/output comes on change and at 10 Hz. The process that publishes it in place of a dead pca9685 takes up to 1.5 s
# to begin; after a second more it is not known what the board holds.
HELD_TIMEOUT_NS = round(2.5 * NS_PER_S)

# The board goes to neutral by itself 250 ms after a command; after a pull 80 ms, unless calibrate_esc saw that the ESC
# is a brake_then_reverse and the pull is its first after a push (``pca9685.channels``). So after a pause of the node
# that was longer than this it may have been there, whether it has said so or not.
BOARD_HOLDS_NS, BOARD_HOLDS_PULL_NS = round(0.2 * NS_PER_S), round(0.06 * NS_PER_S)

# An ESC that was pushed for so long has seen that it drives, whatever it needs for that: nobody publishes how long that
# is, and the dwell that calibrate_esc measures is another time.
DROVE_NS = round(0.5 * NS_PER_S)

FORWARD, NEUTRAL, PULLED, FAINT = "forward", "neutral", "pulled", "faint"


class _Account:
    """One sequence of pulses.

    Attributes:
        side: FORWARD, NEUTRAL, PULLED, or FAINT: within the dead band, where the ESC may see either; ``None`` = none.
        since_ns: since when it is that.
        was_pulled, was_released: there was a pull since ``forget``, and after it something else.
    """

    def __init__(self, config: EscConfig):
        self._config = config
        self.side: str | None = None
        self.since_ns = 0
        self.forget()

    def forget(self) -> None:
        self.was_pulled = self.was_released = False

    def update(self, fraction: float | None, now_ns: int) -> None:
        side = self._side(fraction)
        if side != self.side:
            self.side, self.since_ns = side, now_ns
        if side != PULLED and self.was_pulled:
            self.was_released = True
        if side == PULLED or side == FAINT and fraction < 0:
            self.was_pulled = True

    def lasts_ns(self, side: str, now_ns: int) -> int:
        """For how long it has been ``side``, 0 if it is not."""
        return now_ns - self.since_ns if self.side == side else 0

    def _side(self, fraction):
        if fraction is None:
            return None
        if fraction > self._config.dead_band_forward - NEUTRAL_TOLERANCE:
            return FORWARD
        if fraction < -self._config.dead_band_reverse + NEUTRAL_TOLERANCE:
            return PULLED
        return NEUTRAL if abs(fraction) <= NEUTRAL_TOLERANCE else FAINT


class EscHistory:
    """What the ESC has seen."""

    def __init__(self, config: EscConfig):
        self._dwell_ns = round(config.dwell_s * NS_PER_S)
        self._holds_pull_ns = BOARD_HOLDS_NS if config.board_holds_pulls else BOARD_HOLDS_PULL_NS
        self._forget_ns = round(config.reverse_after_neutral_s * NS_PER_S)
        self._sent, self._held = _Account(config), _Account(config)
        self._held_ns: int | None = None  # when the board's last message came
        self._sent_ns: int | None = None  # when the node last sent something
        self._missed = False
        self._drove = False  # it has seen forward, and since then no more than one pull
        self._drives_since_ns = 0  # a push of before was no drive forward: the car rolled backward
        self._braked = self._unlocked = False

    def update_held(self, fraction: float | None, now_ns: int) -> None:
        """What the board holds; ``None`` = no pulse."""
        self._look(now_ns)
        self._held_ns = now_ns
        self._missed = self._missed or fraction is None
        self._held.update(fraction, now_ns)
        self._look(now_ns)

    def resume(self, now_ns: int) -> None:
        """The node goes on: what it sent last may not have been there all the time since."""
        holds_ns = self._holds_pull_ns if self._sent.side == PULLED else BOARD_HOLDS_NS
        if self._sent_ns is not None and now_ns - self._sent_ns > holds_ns:
            self._look(self._sent_ns + holds_ns)
            self._sent.update(0.0, self._sent_ns + holds_ns)
            self._look(now_ns)

    def update_sent(self, fraction: float, now_ns: int) -> None:
        """What is sent to the board."""
        self._look(now_ns)
        self._sent_ns = now_ns
        self._sent.update(fraction, now_ns)
        self._look(now_ns)

    def mark_backward(self, now_ns: int) -> None:
        """The car may roll backward: a push of now only brakes it, and the next pull may be reverse."""
        self._drives_since_ns = now_ns
        self._drove = False

    def mark_unknown(self) -> None:
        """Messages of the board were dropped: it may have held anything."""
        self._drove = self._braked = self._unlocked = False
        if self._held_ns is not None:
            self._held.since_ns = self._held_ns
            self._held.side = FAINT

    def had_no_pulse(self) -> bool:
        """Whether the board said, now or since the last call, that it gives no pulse."""
        missed, self._missed = self._missed, False
        return missed or self._held_ns is not None and self._held.side is None

    def is_known(self, now_ns: int) -> bool:
        """Whether it is known what the board holds."""
        return self._held_ns is not None and now_ns - self._held_ns <= HELD_TIMEOUT_NS and self._held.side is not None

    def brake_is_certain(self, now_ns: int) -> bool:
        """Whether an ESC that brakes after forward takes a pull at ``now_ns`` for a brake, or goes on braking."""
        self._look(now_ns)
        return self._drove

    def coasted_ns(self, now_ns: int) -> int:
        """For how long it has been in neutral, if there was no pull since it drove; else 0."""
        return 0 if self._held.was_pulled else self._held.lasts_ns(NEUTRAL, now_ns)

    def neutral_ns(self, now_ns: int) -> int:
        """For how long it has had neutral; by what was sent, if the board never said anything."""
        sent_ns = self._sent.lasts_ns(NEUTRAL, now_ns)
        if self._held_ns is None:
            return sent_ns
        return min(sent_ns, self._held.lasts_ns(NEUTRAL, now_ns)) if self.is_known(now_ns) else 0

    def pulled_ns(self, now_ns: int) -> int:
        """For how long the board is known to have held a pull."""
        return self._held.lasts_ns(PULLED, now_ns) if self.is_known(now_ns) else 0

    def has_braked(self, now_ns: int) -> bool:
        """Whether there was a pull of at least the dwell since it drove forward."""
        self._look(now_ns)
        return self._braked

    def is_unlocked(self, now_ns: int) -> bool:
        """Whether it has had what reverse takes: a pull and neutral, each for the dwell, and no forward since."""
        self._look(now_ns)
        return self._unlocked

    def _look(self, now_ns):
        self._look_for_certain_brake(now_ns)
        account = self._sent if self._held_ns is None else self._held
        if account.side in (FORWARD, None) or self._held_ns is not None and not self.is_known(now_ns):
            self._braked = self._unlocked = False
        elif account.lasts_ns(PULLED, now_ns) >= self._dwell_ns:
            self._braked = True
        elif self._braked and account.lasts_ns(NEUTRAL, now_ns) >= self._dwell_ns:
            self._unlocked = True

    def _look_for_certain_brake(self, now_ns):
        if not self.is_known(now_ns):
            self._drove = False
            return
        pushed_ns = min(account.lasts_ns(FORWARD, now_ns) for account in (self._sent, self._held))
        if min(pushed_ns, now_ns - self._drives_since_ns) >= max(self._dwell_ns, DROVE_NS):
            self._drove = True
            self._sent.forget()
            self._held.forget()
        if self._sent.was_released or self._held.was_released:
            self._drove = False
        if self._forget_ns and self.coasted_ns(now_ns) >= self._forget_ns:
            self._drove = False
