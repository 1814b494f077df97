"""Remember the pulses that the ESC has had, and decide whether it takes the next pull for a brake or for reverse.

``EscHistory`` keeps two accounts: what the servo board reported to hold (``/servo/output``, which includes what a guard
or a timeout put there), and what was sent, which the board may hold already without having reported it. What *forbids*
something counts if it is in either account; what *permits* something must be in both.

Pure: pulses as fractions −1..1 in, each with ``now_ns``; yes or no, or a duration, out.
"""
from __future__ import annotations

from car_interface.common.units import NS_PER_S
from car_interface.throttle.esc_config import BRAKE_THEN_REVERSE, EscConfig

# A duty is rounded to counts of 16, and there are about 1640 from neutral to an end: half a count is 0.005.
NEUTRAL_TOLERANCE = 0.01
# /servo/output comes on change and at 10 Hz. The guard that publishes it in place of a dead pca9685 needs up to 1.5 s
# to begin. A second after that it is unknown what the board holds.
HELD_TIMEOUT_NS = round(2.5 * NS_PER_S)
# The board's guard lets go 200 to 250 ms after the node's last sign of life. After so long without a report a pull that
# is given on may be a second one.
LETS_GO_NS = round(0.25 * NS_PER_S)

# The board goes to neutral by itself 250 ms after a command, and 80 ms after a pull, unless calibrate_esc has measured
# a brake_then_reverse and the pull is its first after a push (``pca9685.channels``). A node that pauses for longer
# than this (50 and 20 ms less) must assume that the board was in neutral, even if that wasn't reported. With 2 s
# `python3 test/adversary 400 --seed 700000` finds a reversal.
BOARD_HOLDS_NS, BOARD_HOLDS_PULL_NS = round(0.2 * NS_PER_S), round(0.06 * NS_PER_S)

# An ESC that was pushed for this long takes the next pull for a brake. No maker publishes how long that takes, and the
# dwell that calibrate_esc measures is a different time. Chosen; test_esc_history.py fails with 0.1 s.
DROVE_NS = round(0.5 * NS_PER_S)

FORWARD, NEUTRAL, PULLED, FAINT = "forward", "neutral", "pulled", "faint"


class _Account:
    """Follow one sequence of pulses.

    Attributes:
        side: FORWARD, NEUTRAL, PULLED, or FAINT (within the dead band, where the ESC may see neutral or not);
            ``None`` = no pulse.
        since_ns: when that side began.
        was_pulled: there was a pull since ``forget``.
        was_released: that pull has ended.
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
        if fraction is not None and fraction < -NEUTRAL_TOLERANCE:
            self.was_pulled = True

    def lasts_ns(self, side: str, now_ns: int) -> int:
        """Return for how long it has been on a side; 0 if it isn't."""
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
    """Keep the pulses that one ESC has had."""

    def __init__(self, config: EscConfig):
        self._dwell_ns = round(config.dwell_s * NS_PER_S)
        holds_pulls = config.profile == BRAKE_THEN_REVERSE and config.profile_measured  # after a gap it would reverse
        self._holds_pull_ns = BOARD_HOLDS_NS if holds_pulls else BOARD_HOLDS_PULL_NS
        self._forget_ns = round(config.reverse_after_neutral_s * NS_PER_S)
        self._sent, self._held = _Account(config), _Account(config)
        self._held_ns: int | None = None  # when the board's last message arrived
        self._sent_ns: int | None = None  # when this node last sent a pulse
        self._missed = self._let_go = False
        self._drove = False  # it drove forward, and had no more than one pull since then
        self._drives_since_ns = 0  # an earlier push didn't drive forward: the car rolled backward
        self._braked = self._unlocked = False
        self._pull_ns: int | None = None  # when the newest pull was sent first

    def update_held(self, fraction: float | None, now_ns: int) -> None:
        """Take what the board holds; ``None`` = no pulse."""
        self._account_for_pause(now_ns)
        self._look(now_ns)
        self._held_ns = now_ns
        self._missed = self._missed or fraction is None
        self._held.update(fraction, now_ns)

    def resume(self, now_ns: int) -> bool:
        """Account for a pause of this node; return whether the board may have let go by itself since the last call."""
        self._account_for_pause(now_ns)
        let_go, self._let_go = self._let_go, False
        return let_go

    def _account_for_pause(self, now_ns):
        """Take the board's neutral after a pause, before what it held meanwhile: that is heard only now."""
        holds_ns = self._holds_pull_ns if self._sent.side == PULLED else BOARD_HOLDS_NS
        if self._sent_ns is not None and now_ns - self._sent_ns > holds_ns:
            self._look(self._sent_ns + holds_ns)
            self._sent.update(0.0, self._sent_ns + holds_ns)
            self._let_go = True

    def update_sent(self, fraction: float, now_ns: int) -> None:
        """Take what this node sends to the board."""
        self._look(now_ns)
        self._sent_ns = now_ns
        self._sent.update(fraction, now_ns)

    def mark_backward(self, now_ns: int) -> None:
        """Record that the car may roll backward: a push only brakes it then, and the next pull may be reverse."""
        self._drives_since_ns = now_ns
        self._drove = False

    def mark_unknown(self) -> None:
        """Forget what the board held, since its messages were dropped."""
        self._drove = self._braked = self._unlocked = False
        if self._held_ns is not None:
            self._held.side = FAINT

    def had_no_pulse(self) -> bool:
        """Return whether the board gives no pulse, or reported that since the last call."""
        missed, self._missed = self._missed, False
        return missed or self._held_ns is not None and self._held.side is None

    def is_known(self, now_ns: int) -> bool:
        """Return whether it is known what the board holds."""
        return self._held_ns is not None and now_ns - self._held_ns <= HELD_TIMEOUT_NS and self._held.side is not None

    def brake_is_certain(self, now_ns: int) -> bool:
        """Return whether an ESC that brakes after forward takes a pull at ``now_ns`` for a brake, or keeps braking."""
        self._look(now_ns)
        return self._drove

    def coasted_ns(self, now_ns: int) -> int:
        """Return for how long (ns) it has been in neutral; 0 if there was a pull since it drove."""
        return 0 if self._held.was_pulled else self._held.lasts_ns(NEUTRAL, now_ns)

    def neutral_ns(self, now_ns: int) -> int:
        """Return for how long (ns) it has had neutral; by what was sent, if the board never reported."""
        sent_ns = self._sent.lasts_ns(NEUTRAL, now_ns)
        if self._held_ns is None:
            return sent_ns
        return min(sent_ns, self._held.lasts_ns(NEUTRAL, now_ns)) if self.is_known(now_ns) else 0

    def pulled_ns(self, now_ns: int) -> int:
        """Return for how long (ns) the board is known to have held a pull."""
        return self._held.lasts_ns(PULLED, now_ns) if self.is_known(now_ns) else 0

    def has_braked(self, now_ns: int) -> bool:
        """Return whether there was a pull of at least esc/dwell since it drove forward."""
        self._look(now_ns)
        return self._braked

    def is_unlocked(self, now_ns: int) -> bool:
        """Return whether the next pull reverses: a pull and neutral, each for esc/dwell, and no push since."""
        self._look(now_ns)
        return self._unlocked

    def _look(self, now_ns):
        self._look_for_certain_brake(now_ns)
        account = self._sent if self._held_ns is None else self._held
        if account.side in (FORWARD, None) or self._held_ns is not None and not self.is_known(now_ns):
            self._braked = self._unlocked = False
        elif self._sent.side in (PULLED, FAINT):
            # One that is too short for a brake undoes an earlier one, also if the ESC may see it as neutral.
            is_same = self._sent.since_ns == self._pull_ns
            lasts_ns = min(account.lasts_ns(PULLED, now_ns), self._sent.lasts_ns(PULLED, now_ns))
            self._braked = self._unlocked or is_same and self._braked or lasts_ns >= self._dwell_ns
            self._pull_ns = self._sent.since_ns
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
        if (self._sent.was_pulled or self._held.was_pulled) and now_ns - self._held_ns > LETS_GO_NS:
            self._drove = False
        if self._forget_ns and self.coasted_ns(now_ns) >= self._forget_ns:
            self._drove = False
