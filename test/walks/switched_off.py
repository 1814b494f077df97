"""Mechanisms that can be switched off, to see that the monitor finds it. Each takes pytest's monkeypatch."""
import math

from car_interface.interlock.motion_interlock import MotionInterlock
from car_interface.pca9685.channels import Channels
from car_interface.teleop.gamepad import Gamepad
from car_interface.throttle.arbiter import ThrottleArbiter


def _after_init(monkeypatch, owner, change):
    init = owner.__init__

    def changed(self, *args, **kwargs):
        init(self, *args, **kwargs)
        change(self)
    monkeypatch.setattr(owner, "__init__", changed)


def timeout_of_the_deadman(monkeypatch):
    _after_init(monkeypatch, MotionInterlock, lambda self: setattr(self._human, "_timeout_ns", math.inf))


def timeout_of_the_gamepad(monkeypatch):
    _after_init(monkeypatch, Gamepad, lambda self: setattr(self.joy, "_timeout_ns", math.inf))


def rearming(monkeypatch):
    def nothing(self, now_ns):
        self._waiting_since_ns, self._rearm_reason = self._waiting_since_ns or now_ns, ""
    monkeypatch.setattr(MotionInterlock, "_update_rearm_reason", nothing)


def stop_of_throttle_without_steering(monkeypatch):
    monkeypatch.setattr(ThrottleArbiter, "_steering_trouble", lambda self, now_ns: None)
    _after_init(monkeypatch, ThrottleArbiter, lambda self: setattr(self, "_board", None))


def timeout_of_the_board(monkeypatch):
    monkeypatch.setattr(Channels, "_timeout_ms", lambda self, channel, duty: 0)
