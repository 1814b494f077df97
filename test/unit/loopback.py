"""What tests of connections share: small XML-RPC servers on loopback, and waiting for what other threads do."""
import threading
import time
from contextlib import contextmanager
from xmlrpc.server import SimpleXMLRPCServer

PATIENCE_S = 30.0


def eventually(condition):
    """Wait until a condition is true."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


@contextmanager
def serving(**methods):
    """Yield the URI of a server that answers one question after the other, as a master or a node."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        for name, method in methods.items():
            server.register_function(method, name)
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()
