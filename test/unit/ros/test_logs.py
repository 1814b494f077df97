"""What a node says never holds it up, whoever takes it or doesn't."""
import subprocess
import sys

import pytest

pytest.importorskip("rospy")

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


PEER_LEAVES = """
import logging, socket, threading
from rospy.impl.tcpros_base import TCPServer
from car_interface.ros.logs import keep_tracebacks_from_terminal

logged = threading.Event()

class LogFile(logging.Handler):
    def emit(self, record):
        print("log file:", record.getMessage().splitlines()[-1], flush=True)
        logged.set()

def answer(peer, address):
    raise BrokenPipeError(32, "Broken pipe")

logging.getLogger("car_interface").addHandler(LogFile())
logging.getLogger("car_interface").propagate = False
keep_tracebacks_from_terminal()
server = TCPServer(answer)
server.start()
socket.create_connection(("127.0.0.1", server.get_full_addr()[1])).close()
logged.wait(30.0)
"""


def test_peer_that_leaves_in_a_handshake_prints_no_traceback():
    done = subprocess.run([sys.executable, "-B", "-c", PEER_LEAVES], capture_output=True, text=True, check=True,
                          timeout=60, env={"PYTHONPATH": ":".join(sys.path), "ROS_IP": "127.0.0.1"})
    assert done.stdout == "log file: BrokenPipeError: [Errno 32] Broken pipe\n" and "Traceback" not in done.stderr
