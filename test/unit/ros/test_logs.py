"""What a node says never holds it up, whoever takes it or doesn't."""
from __future__ import annotations

import subprocess
import sys

# In an interpreter of its own: pytest's handlers are the root logger's, too.
SCRIPT = """
import logging, threading
from car_interface.ros.logs import MAX_LINES, LogThreads

free = threading.Event()

class Disk(logging.Handler):
    def emit(self, record):
        free.wait()
        print("disk:", record.getMessage())

class Terminal(logging.Handler):
    def emit(self, record):
        print("terminal:", record.getMessage())

logging.raiseExceptions = False  # as a node has it
logging.getLogger().addHandler(Disk())
rosout = logging.getLogger("rosout")
rosout.addHandler(Terminal())
logs = LogThreads()
rosout.warning("%s is held down", "the bus")
print("written:", logs.flush(0.5))
for number in range(2 * MAX_LINES):
    logging.getLogger().warning("line %d", number)
print("goes on")
free.set()
print("written:", logs.flush(30.0))
"""


def test_disk_that_stalls_holds_up_neither_the_node_nor_the_terminal():
    done = subprocess.run([sys.executable, "-B", "-c", SCRIPT], capture_output=True, text=True, check=True,
                          timeout=60, env={"PYTHONPATH": ":".join(sys.path)})
    before, after = done.stdout.split("goes on\n")
    assert before == "terminal: the bus is held down\nwritten: False\n"
    *late, last = after.splitlines()
    assert late[:2] == ["disk: the bus is held down", "disk: line 0"] and last == "written: True"
    assert len(late) == 1 + 1000  # one was under way; of the rest as many as may wait
    assert done.stderr == ""
