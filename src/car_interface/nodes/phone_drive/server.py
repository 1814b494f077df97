"""The server of phone_drive: moves texts between WebSockets and the node's inbox, in a thread of its own.

It decides nothing about the car. It refuses what no page of this car sends: requests for another host (DNS rebinding),
from another origin, messages that are too long, and more connections than it can serve.
"""
from __future__ import annotations

import asyncio
import ipaddress
import itertools
import logging
import os
import secrets
import ssl
import threading
from collections import OrderedDict, deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from car_interface.common.errors import ConfigError, DeviceError
from car_interface.common.input_file import check_kind
from car_interface.nodes.phone_drive.config import PhoneDriveConfig
from car_interface.teleop.phone import Outgoing, Phones
from car_interface.teleop.phone_messages import MAX_SIZE

LOOPBACK = ("127.0.0.1", "localhost")
MAX_BYTES = 4 * MAX_SIZE  # of a message: UTF-8
MAX_HEADER = 8192
HEADER_S = 5  # for a request to arrive
MAX_OPEN = 64  # connections that are no WebSocket, or not yet
MAX_SOCKETS = 64  # WebSockets; the rules admit 8, and close the others
MAX_CLOSING = 16  # of these whose pages don't answer to that
MAX_PINGS = 20  # of a connection; a browser sends none
MAX_UNHANDLED = 100  # messages of a connection that the node has not handled yet
MAX_UNSENT = 40  # messages that a page has not taken yet: 2 s of tokens
MAX_TICKETS, TICKET_S = 16, 60  # of files, and how long one is good for
MAX_DOWNLOADS, CHUNK = 2, 65536  # bytes
CHUNK_S = 20  # for a page to take a chunk: 3 kB a second; slower ones would keep the others from theirs
# A report is of a recording, whose texts others have written: it runs no script, and is of no origin.
REPORT_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"
END_S = 2
PAGE = Path(__file__).with_name("page")  # index.html, and what it names
KINDS = {".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml",
         ".js": "text/javascript; charset=utf-8"}
# Of a tab that shows a file, or nothing else.
ERRORS = {403: "Open this page by the address that the terminal shows.",
          404: "There is no such page; a file's link is good once, for a minute.",
          503: "Too many files are being sent: try again when they are done."}
NO_POLICY = "default-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"  # of what shows nothing
# Of the page. 'self' doesn't allow a WebSocket in Safari before 15.4.
POLICY = NO_POLICY + ("; script-src 'self'; style-src 'self'; img-src 'self'; manifest-src 'self'; "
                      "connect-src 'self' ws://{host} wss://{host}")
HEADERS = {
    "Content-Security-Policy": NO_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Server:
    """Serves the page at ``/``, and WebSockets at ``/ws``.

    Args:
        config: where.
        inbox: the node's; ``put`` is called in the server's thread.
        phones: learns in the node's thread what happens on the connections.

    Raises:
        DeviceError: the address can't be used.
        ConfigError: the certificate or its key can't be, or the address is all of this computer's.
    """

    def __init__(self, config: PhoneDriveConfig, inbox: Any, phones: Phones):
        self.hosts = {config.host, *(f"{name}:{config.port}" for name in LOOPBACK)}
        self._tls = _tls(config)
        self.scheme = "https" if self._tls else "http"
        # Path and end, the oldest first. Both threads use it: each of its methods is whole before another thread runs.
        self.tickets: OrderedDict[str, tuple[str, float]] = OrderedDict()
        self.downloads: set[_File] = set()
        self.inbox, self.phones = inbox, phones
        self.sockets: dict[int, _Socket] = {}  # by number; of the server's thread
        self.numbers = itertools.count(1)
        self._closing: deque[_Socket] = deque()  # the oldest first
        self._bound = _bind(config)
        self._has_started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="phone server", daemon=True)
        self._thread.start()
        self._has_started.wait()

    # --- for the node's thread ---

    def send(self, outgoing: Outgoing) -> None:
        """Send a text to a page, and close its connection after that where it says so."""
        self.loop.call_soon_threadsafe(self._send, outgoing)

    def offer(self, path: str) -> str:
        """Return where the next request, and no other, gets a file."""
        ticket = secrets.token_urlsafe(16)
        self.tickets[ticket] = path, self.loop.time() + TICKET_S
        if len(self.tickets) > MAX_TICKETS:
            self.tickets.popitem(last=False)
        return f"/files/{ticket}/{Path(path).name}"

    def stop(self) -> None:
        """Close everything."""
        self.loop.call_soon_threadsafe(self._end.set)
        self._thread.join(END_S)

    # --- the server's thread ---

    async def _serve(self):
        for name in ("tornado.general", "tornado.access"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # whoever sends nonsense must not fill the log
        self.loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        # A request opens none of the page's files. What is no path of it gets a page without files.
        files = {path.name: path.read_bytes() for path in PAGE.glob("*") if path.suffix in KINDS}
        application = Application([("/ws", _Socket, {"server": self}),
                                   (r"/files/([A-Za-z0-9_-]+)/[A-Za-z0-9._-]+", _File, {"server": self}),
                                   (r"/([a-z0-9_.]*)", _Page, {"server": self, "files": files})],
                                  default_handler_class=_Page, default_handler_args={"server": self, "files": {}},
                                  websocket_max_message_size=MAX_BYTES, log_function=lambda handler: None)
        http = _HttpServer(application, max_header_size=MAX_HEADER, max_body_size=MAX_BYTES,
                           idle_connection_timeout=HEADER_S, body_timeout=HEADER_S, ssl_options=self._tls)
        http.add_sockets(self._bound)
        self._has_started.set()
        await self._end.wait()
        http.stop()
        # asyncio.run waits for what it cancels. Before Python 3.12 wait_for may take no notice of that, so a download
        # would go on to its end.
        for each in [*self.sockets.values(), *self.downloads]:
            each.abort()

    def _send(self, outgoing):
        if outgoing.connection in self.sockets:
            socket = self.sockets[outgoing.connection]
            socket.send(outgoing.text)
            if outgoing.closes:
                socket.close()
                self._closing.append(socket)
                if len(self._closing) > MAX_CLOSING:
                    self._closing.popleft().abort()


def _bind(config):
    """Return sockets that listen at the address alone, also where a name or `0` stands for it."""
    try:
        bound = bind_sockets(config.port, config.address)
    except (OSError, UnicodeError) as error:  # UnicodeError: no name can be so
        raise DeviceError(f"phones' page at ~address {config.address}, ~port {config.port}", str(error),
                          "Set another address of this computer, or another port") from error
    if any(ipaddress.ip_address(each.getsockname()[0].partition("%")[0]).is_unspecified for each in bound):
        for each in bound:
            each.close()
        # A page under another address than this is refused: RFC 6454's origin has it, and a name could be rebound.
        raise ConfigError("address", config.address,
                          "one of this computer's addresses, or a name of it: the one that phones will open")
    return bound


def _tls(config):
    """Return the context of https; None: it is http."""
    if config.certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        for path in (config.certificate, config.key):
            check_kind(os.stat(path))  # OpenSSL would wait for who writes to a pipe
        context.load_cert_chain(config.certificate, config.key, password="")  # or OpenSSL asks the terminal for one
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError("certificate", config.certificate,
                          f"a PEM file with ~key {config.key}, which needs no password ({error})") from error
    return context


class _HttpServer(HTTPServer):
    """Ends the oldest of too many connections that don't ask for anything."""

    _waiting = ()

    def handle_stream(self, stream, address):
        self._waiting = [other for other in self._waiting if not (other.closed() or hasattr(other, "is_served"))]
        if len(self._waiting) >= MAX_OPEN:
            self._waiting.pop(0).close()
        self._waiting.append(stream)
        super().handle_stream(stream, address)


class _Guarded(RequestHandler):
    """Answers only requests for this host that come from its own page."""

    needs_origin = False

    def initialize(self, server):
        self._server = server

    def set_default_headers(self):
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self):
        self._stream = self.request.connection.stream  # a WebSocket takes it off the request
        origin = self.request.headers.get("Origin")
        is_own = origin == f"{self._server.scheme}://{self.request.host}"
        if self.request.host not in self._server.hosts or not is_own and (self.needs_origin or origin is not None):
            self.send_error(403)

    def write_error(self, status_code, **_):
        # Nothing of the request, which might be a script.
        self.finish(f"{status_code}. {ERRORS.get(status_code, '')}\n")

    def abort(self):
        """Close its connection without waiting for what the page has not taken."""
        self._stream.close()


class _File(_Guarded):
    """A report, shown in a sandbox, or a recording, to be saved."""

    async def get(self, ticket):
        path, end_s = self._server.tickets.pop(ticket, ("", 0.0))
        is_good = self._server.loop.time() < end_s
        if not is_good or len(self._server.downloads) >= MAX_DOWNLOADS:
            self.send_error(503 if is_good else 404)
            return
        self._server.downloads.add(self)
        self._stream.is_served = True
        try:
            with open(path, "rb") as file:
                await self._send_file(path, file)
        except (StreamClosedError, asyncio.TimeoutError, asyncio.CancelledError):  # cancelled: the node ends
            self.abort()
        except OSError:
            self.send_error(404)
        finally:
            self._server.downloads.discard(self)

    async def _send_file(self, path, file):
        if path.endswith(".html"):
            self.set_header("Content-Type", KINDS[".html"])
            self.set_header("Content-Security-Policy", REPORT_POLICY)
        else:
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("Content-Disposition", f'attachment; filename="{Path(path).name}"')
        while chunk := file.read(CHUNK):
            self.write(chunk)
            await asyncio.wait_for(self.flush(), CHUNK_S)


class _Page(_Guarded):
    def initialize(self, server, files):
        super().initialize(server)
        self._files = files

    def get(self, name=""):
        name = name or "index.html"
        content = self._files.get(name)
        if content is None:
            self.send_error(404)
            return
        self.set_header("Content-Security-Policy", POLICY.format(host=self.request.host))  # which is one of ours
        self.set_header("Content-Type", KINDS[Path(name).suffix])
        self.finish(content)


class _Socket(_Guarded, WebSocketHandler):
    needs_origin = True

    def initialize(self, server):
        super().initialize(server)
        self.room = threading.Semaphore(MAX_UNHANDLED)  # for messages that the node has not handled yet
        self._unsent = self._pings = 0
        self._number = None

    def prepare(self):
        super().prepare()
        if not self._finished and len(self._server.sockets) >= MAX_SOCKETS:
            self.send_error(503)

    def check_origin(self, origin):
        return True  # prepare has checked it

    def open(self, *_):
        server, self._stream.is_served = self._server, True
        self.set_nodelay(True)
        self._number = next(server.numbers)
        server.sockets[self._number] = self
        server.inbox.put(lambda item, now_ns: server.phones.connect(*item, now_ns),
                         (self._number, self.request.remote_ip))

    def on_message(self, message):
        """Pass a message on; end a connection that sends faster than the node handles."""
        if self.room.acquire(blocking=False):
            self._server.inbox.put(self._handle, (self._number, message), on_drop=self.room.release)
        else:
            self.abort()

    def _handle(self, item, now_ns):
        self.room.release()
        self._server.phones.receive(*item, now_ns)

    def on_ping(self, data):
        """Limit what is answered: a page that doesn't take the answers would have them pile up."""
        self._pings += 1
        if self._pings > MAX_PINGS:
            self.abort()

    on_pong = on_ping

    def on_close(self):
        if self._number is not None:
            self._server.sockets.pop(self._number, None)
            self._server.inbox.put(lambda number, now_ns: self._server.phones.disconnect(number), self._number)

    def send(self, text):
        if self._unsent >= MAX_UNSENT:
            self.abort()
            return
        with suppress(WebSocketClosedError):
            written = self.write_message(text)
            self._unsent += 1
            written.add_done_callback(self._count_sent)

    def _count_sent(self, written):
        written.exception()  # it was closed meanwhile, which on_close says
        self._unsent -= 1
