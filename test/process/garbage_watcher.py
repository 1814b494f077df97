#!/usr/bin/env python3
"""A node of the package, named by the first argument, that prints each garbage collection of its process.

    collection step|idle MILLISECONDS OBJECTS
"""
from __future__ import annotations

import gc
import importlib
import sys
import threading
import time

from car_interface.ros import runtime

stepping = set()  # threads that are in a step of a node
begun_ns = [0, False]


def watched(node_class):
    class Watched(node_class):
        def step(self, now_ns):
            stepping.add(threading.get_ident())
            try:
                return super().step(now_ns)
            finally:
                stepping.discard(threading.get_ident())
    return Watched


def note(phase, info):
    if phase == "start":
        begun_ns[:] = time.monotonic_ns(), bool(stepping) or threading.current_thread().name != MAIN
    else:
        took_ms = (time.monotonic_ns() - begun_ns[0]) / 1e6
        sys.stdout.write(f"collection {'step' if begun_ns[1] else 'idle'} {took_ms:.3f} {len(gc.get_objects())}\n")


MAIN = threading.current_thread().name
name, class_name = sys.argv.pop(1).split(":")
module = importlib.import_module(f"car_interface.nodes.{name}")
node = watched(getattr(module, class_name))
if name == "car_nodes":
    module.NODES = {part: watched(part_class) for part, part_class in module.NODES.items()}


def make(params, inbox):
    """The node, from whose start on collections are printed."""
    built = node(params, inbox)
    gc.callbacks.append(note)
    return built


runtime.run(name, make)
