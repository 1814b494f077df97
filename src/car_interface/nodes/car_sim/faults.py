"""The service that injects faults into a virtual device, for tests and trials. Real devices don't offer it."""
from __future__ import annotations

import math
from typing import Callable

import rospy

from car_interface.common.errors import ConfigError
from car_interface.ros.topics import serve
from car_interface.srv import InjectFault


def serve_faults(inbox, faults: dict[str, Callable[[float], None]]) -> None:
    """Offer ~inject_fault; a fault's function runs in the node's thread and raises ConfigError on a bad value."""
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

    serve("~inject_fault", InjectFault, inbox, inject)
