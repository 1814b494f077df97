"""The service by which tests and drives on the desk make a virtual device misbehave. Real devices don't offer it."""
from __future__ import annotations

import math
from concurrent.futures import Future
from typing import Callable

import rospy

from car_interface.errors import ConfigError
from car_interface.srv import InjectFault, InjectFaultResponse


def serve_faults(inbox, faults: dict[str, Callable[[float], None]]) -> None:
    """Offer ~inject_fault; a fault's function runs in the node's thread. It refuses a value with a ConfigError."""
    def inject(request, done):
        if request.fault not in faults:
            done.set_result((False, f"there is no fault {request.fault!r}, only {', '.join(sorted(faults))}"))
        elif not math.isfinite(request.value):
            done.set_result((False, f"{request.value} is no number to act on"))
        else:
            try:
                faults[request.fault](request.value)
            except ConfigError as error:
                done.set_result((False, str(error)))
                return
            rospy.logwarn("fault: %s %g", request.fault, request.value)
            done.set_result((True, "done"))

    def handle(request):
        done: Future = Future()
        inbox.put(lambda item, now_ns: inject(item, done), request)
        return InjectFaultResponse(*done.result())

    rospy.Service("~inject_fault", InjectFault, handle)
