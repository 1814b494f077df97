#!/usr/bin/env python3
"""car_nodes whose parts fail on request: an Empty on /fail/PART raises, a Float32 on /hang/PART is slept, there."""
import sys
import time

from std_msgs.msg import Empty, Float32

from car_interface.nodes import car_nodes
from car_interface.ros.topics import subscribe


def faulty(name, node_class):
    class Faulty(node_class):
        def __init__(self, params, inbox):
            super().__init__(params, inbox)
            subscribe(f"/fail/{name}", Empty, inbox, self._fail)
            subscribe(f"/hang/{name}", Float32, inbox, self._hang)

        def _hang(self, message, now_ns):
            print(f"{name} hangs", file=sys.stderr, flush=True)
            time.sleep(message.data)

        def _fail(self, message, now_ns):
            raise ZeroDivisionError("asked for")
    return Faulty


car_nodes.NODES = {name: faulty(name, node_class) for name, node_class in car_nodes.NODES.items()}
car_nodes.main()
