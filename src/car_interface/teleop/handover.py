"""Decides whose requests count: the gamepad's or a phone's.

The gamepad goes first: while its deadman is held the phone doesn't count. Each change from one to the other passes
through a stop. A phone that was touched while the gamepad's deadman was held counts once it was let go, and a gamepad
whose deadman was pressed while the phone drove likewise.
"""
from __future__ import annotations

from dataclasses import replace

from car_interface.common import causes
from car_interface.teleop.gamepad import NONE, REARM_TEXT, Gamepad, GamepadConfig, Requests

PHONE_TOPIC = "phone/joy"
PHONE_PREFIX = "phone: "  # of a reason that is about the phone
PHONE_TIMEOUT_S = 0.25  # phone_drive repeats its message 20 times a second, as a gamepad's driver does
AXES = STEERING, THROTTLE = 0, 1  # of a message on phone/joy
BUTTONS = MANUAL, AUTONOMOUS, FASTER, SLOWER = 0, 1, 2, 3


class Handover:
    """The gamepad and the phone, and which of them drives.

    Args:
        config: the gamepad's. The phone has the same neutral and dead bands, and indices of its own.
    """

    def __init__(self, config: GamepadConfig):
        self.gamepad = Gamepad(config)  # another one may take its place
        phones = replace(config, steer_axis=STEERING, throttle_axis=THROTTLE, manual_button=MANUAL,
                         autonomous_button=AUTONOMOUS, faster_button=FASTER, slower_button=SLOWER, third_button=NONE,
                         steer_scale=1.0, throttle_scale=1.0, joy_timeout_s=PHONE_TIMEOUT_S)
        self.phone = Gamepad(phones, topic=PHONE_TOPIC, name="the phone")
        self._neutral = config.steer_neutral
        self._phone_drives = False
        self._gamepad_holds = False
        self._gamepad_must_release = self._phone_must_release = False
        self.phone_is_current = False  # the newest requests are the phone's

    def mark_stale(self) -> None:
        self.gamepad.joy.mark_stale()
        self.phone.joy.mark_stale()

    def requests(self, now_ns: int) -> Requests:
        """Return the requests at ``now_ns``. To be called before and after each message, or an edge would be missed."""
        gamepad = self.gamepad.requests(now_ns)
        return self._choose(gamepad, self.phone.requests(now_ns), now_ns) if self.phone.joy.was_received else gamepad

    def scale_button(self, now_ns: int) -> int:
        """Return 1 or −1 while the button for more or less speed by hand is pressed; 0: neither is, or both are.

        Either's counts, whoever drives: a person beside the car makes it slower before he takes over, too.
        """
        return self.gamepad.scale_button(now_ns) or self.phone.scale_button(now_ns)

    def _choose(self, gamepad, phone, now_ns):
        begins = gamepad.holds_deadman and not self._gamepad_holds
        self._gamepad_holds = gamepad.holds_deadman
        self._gamepad_must_release = gamepad.holds_deadman and (
            self._gamepad_must_release or begins and self._phone_drives)
        self._phone_must_release = phone.holds_deadman and (self._phone_must_release or gamepad.holds_deadman)
        self._phone_drives = phone.human_in_loop and not self._phone_must_release
        if gamepad.holds_deadman:
            self.phone_is_current = False
        elif phone.holds_deadman or not self.gamepad.axes:
            self.phone_is_current = True
        if self.phone_is_current:
            return self._count(phone, self._phone_must_release, "the gamepad's deadman was held", PHONE_PREFIX,
                               self.gamepad, now_ns)
        return self._count(gamepad, self._gamepad_must_release, "the phone drove", "", self.phone, now_ns)

    def _count(self, requests, must_release, why, prefix, other, now_ns):
        """Return one source's requests, or that its deadman must be released first."""
        if must_release:
            return Requests(False, self._neutral, 0.0, causes.NOT_REARMED, f"{prefix}{why}; {REARM_TEXT}")
        if requests.human_in_loop:
            other.follow(now_ns)
        return requests._replace(reason=f"{prefix}{requests.reason}")
