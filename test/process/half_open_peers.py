#!/usr/bin/env python3
"""Connects to TCP ports and sends nothing: half_open_peers.py PORT… COUNT hold|reopen.

A line on standard output when all were begun: a node without room for them leaves them to the kernel. ``reopen`` makes
a new connection for each that the other side has ended.
"""
import resource
import selectors
import socket
import sys


def main():
    *ports, count, mode = sys.argv[1:]
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    selector = selectors.DefaultSelector()

    def connect(port):
        peer = socket.socket()
        peer.setblocking(False)
        peer.connect_ex(("127.0.0.1", int(port)))
        selector.register(peer, selectors.EVENT_WRITE, port)  # until it is connected
    for port in ports:
        for _ in range(int(count)):
            connect(port)
    print("open", flush=True)
    while True:
        for key, events in selector.select():
            if events & selectors.EVENT_WRITE:
                selector.modify(key.fileobj, selectors.EVENT_READ, key.data)
            else:
                selector.unregister(key.fileobj)
                key.fileobj.close()
                if mode == "reopen":
                    connect(key.data)


if __name__ == "__main__":
    main()
