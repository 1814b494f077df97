"""A TCP relay between browsers and a server: what a WLAN does to their connections, and no browser can emulate.

Chromium's own emulation of networks closes a WebSocket or leaves it alone. A phone that is out of range does neither:
its connection stays open and says nothing, or what it said arrives late and all at once.
"""
from __future__ import annotations

import asyncio
import threading
from contextlib import suppress

CHUNK = 65536
UP, DOWN = "up", "down"  # to the server, to the browser


class _Way:
    """One way of one connection: chunks go out in order, each after its delay."""

    def __init__(self, relay, reader, writer):
        self._relay, self._reader, self._writer = relay, reader, writer
        self.is_cut = relay.is_cut
        self._passes = asyncio.Event()
        self._passes.set()
        self._chunks = asyncio.Queue()

    def hold(self):
        self._passes.clear()

    def release(self):
        self._passes.set()

    async def read(self):
        loop = asyncio.get_running_loop()
        with suppress(OSError):
            while chunk := await self._reader.read(CHUNK):
                self._chunks.put_nowait((loop.time() + self._relay.delay_s(), chunk))
        self._chunks.put_nowait((loop.time(), b""))

    async def write(self):
        loop = asyncio.get_running_loop()
        with suppress(OSError):
            while True:
                due_s, chunk = await self._chunks.get()
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                await self._passes.wait()
                if self.is_cut:
                    continue
                if not chunk:
                    break
                self._writer.write(chunk)
                await self._writer.drain()
        self._writer.close()


class Relay:
    """Listens at one address and passes on to another one. Its methods are called by the test.

    Attributes:
        delay_s: called for each chunk of either way.
        is_cut: nothing of the connections passes, ever; after ``mend`` new ones do.
        count: how many connections there were.
    """

    def __init__(self, listens: tuple[str, int], target: tuple[str, int]):
        self.delay_s, self.is_cut, self.count = lambda: 0.0, False, 0
        self._listens, self._target = listens, target
        self._ways: dict[str, list[_Way]] = {UP: [], DOWN: []}
        self._loop = asyncio.new_event_loop()
        started = threading.Event()
        threading.Thread(target=self._run, args=(started,), daemon=True).start()
        started.wait()

    def _run(self, started):
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(asyncio.start_server(self._pass_on, *self._listens))
        started.set()
        self._loop.run_forever()

    async def _pass_on(self, reader, writer):
        self.count += 1
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._target)
        except OSError:
            writer.close()
            return
        ways = {UP: _Way(self, reader, far_writer), DOWN: _Way(self, far_reader, writer)}
        for name, way in ways.items():
            self._ways[name].append(way)
        await asyncio.gather(*(run() for way in ways.values() for run in (way.read, way.write)))

    def cut(self) -> None:
        """Let nothing pass any more, and close nothing."""
        self.is_cut = True
        for way in self._ways[UP] + self._ways[DOWN]:
            way.is_cut = True

    def mend(self) -> None:
        self.is_cut = False

    def hold(self, name: str) -> None:
        """Keep what comes on one way of the connections that there are."""
        for way in self._ways[name]:
            self._loop.call_soon_threadsafe(way.hold)

    def release(self) -> None:
        """Deliver all that was kept, at once."""
        for way in self._ways[UP] + self._ways[DOWN]:
            self._loop.call_soon_threadsafe(way.release)
