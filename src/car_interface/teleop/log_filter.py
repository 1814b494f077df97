"""Selects the changes of the gamepad's requests that get a line in the log."""
from __future__ import annotations

from car_interface.common.units import NS_PER_S
from car_interface.teleop.gamepad import Requests

PERIOD_NS = 10 * NS_PER_S  # as all warnings of this package


class RequestsLogFilter:
    """Finds changes of the cause, and of the causes of the sticks.

    Each change is new where a human comes, goes or is there. Without a human each cause is new at most once in 10 s,
    since a gamepad at the edge of its range comes and goes several times a second. A cause that lasts becomes new in
    the end.
    """

    def __init__(self):
        self._logged: Requests | None = None
        self._next_ns: dict[tuple, int] = {}  # by kind

    def is_new(self, requests: Requests, now_ns: int) -> bool:
        """Return whether to log ``requests`` at ``now_ns``; if so, the next ones are compared with them."""
        logged = self._logged
        if logged is not None and logged.kind == requests.kind:
            return False
        without_human = logged is not None and not (logged.human_in_loop or requests.human_in_loop)
        if without_human and now_ns < self._next_ns.get(requests.kind, now_ns):
            return False
        self._logged, self._next_ns[requests.kind] = requests, now_ns + PERIOD_NS
        return True
