#!/usr/bin/env python3
"""turn_arb with an inbox for few messages; a Float32 on ~hang is slept in its thread, while rospy's go on hearing."""
from __future__ import annotations

import functools
import time

from std_msgs.msg import Float32

from car_interface.nodes import turn_arb
from car_interface.ros import runtime
from car_interface.ros.topics import subscribe

LIMIT = 50


class HangingTurnArb(turn_arb.TurnArb):
    def __init__(self, params, inbox):
        super().__init__(params, inbox)
        subscribe("~hang", Float32, inbox, lambda message, now_ns: time.sleep(message.data))


runtime.Inbox = functools.partial(runtime.Inbox, limit=LIMIT)
runtime.run("turn_arb", HangingTurnArb)
