"""Work that takes long, in a thread beside a node's own, whose result the node's thread gets."""
from __future__ import annotations

from typing import Any, Callable

from car_interface.ros.inbox import Inbox


def in_thread(inbox: Inbox, work: Callable[[], Any], handler: Callable[[Any, int], None]) -> None:
    """Have ``handler(work(), now_ns)`` called in the node's thread. What ``work`` raises is raised there, too."""
    def run():
        try:
            result = work()
        except Exception as error:
            inbox.put(_fail, error)
            return
        inbox.put(handler, result)
    inbox.graph.start_thread(run, "work")


def _fail(error, now_ns):
    raise error
