"""Finds and makes frames on the serial line: flag, escape, checksum.

``FrameDecoder`` takes the bytes that arrive and returns the whole frames with a right checksum; it never raises, and
counts corrupt frames. ``encode`` makes the bytes of one frame for the Teensy. Neither touches a port.

On the line a frame is ``7e | body | chk | 7e``; inside, 7e and 7d travel as ``7d (b ^ 20)``, as in HDLC (ISO 13239).
"""
from __future__ import annotations

from dataclasses import dataclass

FLAG, ESCAPE = b"\x7e", b"\x7d"
_ESCAPED_FLAG, _ESCAPED_ESCAPE = b"\x7d\x5e", b"\x7d\x5d"
_FLIP = 0x20  # an escaped byte is xored with it
HEADER_SIZE = 4  # dst, src, cmd, reserved
MAX_BODY = 36  # header + two wheels of 16 bytes; also the maximum of the Teensy's receiver
MAX_ON_LINE = 2 * (MAX_BODY + 1)  # with each byte of the body and the checksum escaped

SHIPPED = "shipped"  # the checksum that the Teensy's receiver really computes
CORRECTED = "corrected"  # the intended one, which its transmitter computes

# 39 zeros bring the shipped receiver to "waiting for an opening flag" from any of its states; 38 miss one of them.
RESYNC_FILLER = bytes(39)


@dataclass
class LineTally:
    """Counts of the decoder."""

    bytes_in: int = 0
    frames: int = 0  # whole, and their checksum right
    noise_bytes: int = 0  # all but these, flags, and what is still pending
    bad_checksum: int = 0
    bad_escape: int = 0  # an escape before a flag (an aborted frame) or before a byte that needs none
    too_long: int = 0

    @property
    def bad_frames(self) -> int:
        """Return the corrupt frames of all kinds."""
        return self.bad_checksum + self.bad_escape + self.too_long


class FrameDecoder:
    """Finds frames in a stream. It never holds more than ``MAX_ON_LINE`` bytes between two calls."""

    def __init__(self):
        self.tally = LineTally()
        self._pending = b""
        self._begun = False  # the first flag has been seen; what lies before it is the tail of a frame at most
        self._overlong = False  # inside something longer than a frame: wait for the next flag

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies (header and payload, unescaped) of the frames that ``data`` completes, in order.

        A flag ends one frame and may begin the next. Repeated flags, and bytes before the first flag, are no frames.
        The checksum test: bytes whose one's-complement sum is ff spell a number other than 0 that 255 divides,
        since 256 ≡ 1 modulo 255.
        """
        tally = self.tally
        tally.bytes_in += len(data)
        segments = (self._pending + data).split(FLAG)
        self._pending = segments.pop()
        if segments and (self._overlong or not self._begun):
            tail = segments.pop(0)
            tally.noise_bytes += len(tail)
            tally.too_long += not self._overlong and len(tail) > MAX_ON_LINE
            self._begun, self._overlong = True, False
        bodies = []
        for segment in segments:
            if not segment:
                continue
            frame = _unescape(segment) if ESCAPE in segment else segment
            number = int.from_bytes(frame, "little")
            if not number % 255 and number and HEADER_SIZE < len(frame) <= MAX_BODY + 1:
                bodies.append(frame[:-1])
            else:
                self._reject(segment, frame)
        tally.frames += len(bodies)
        if self._overlong or len(self._pending) > MAX_ON_LINE:
            tally.too_long += not self._overlong
            self._overlong = True
            self._discard_pending()
        return bodies

    @property
    def pending(self) -> int:
        return len(self._pending)

    def reset(self) -> None:
        """Forget an unfinished frame, and begin with the next flag: the line was reopened."""
        self._discard_pending()
        self._begun = self._overlong = False

    def _reject(self, segment, frame):
        tally = self.tally
        tally.noise_bytes += len(segment)
        if len(segment) > MAX_ON_LINE or len(frame) > MAX_BODY + 1:
            tally.too_long += 1
        elif not frame:
            tally.bad_escape += 1
        elif len(frame) > HEADER_SIZE:  # a shorter one is harmless: the Teensy's boot frame is one
            tally.bad_checksum += 1

    def _discard_pending(self):
        self.tally.noise_bytes += len(self._pending)
        self._pending = b""


def _unescape(segment: bytes) -> bytes:
    """Return the segment without its escapes; empty if one of them escapes anything but 7e or 7d.

    The order matters: ``7d 5d 5e`` is an escaped 7d and a plain 5e.
    """
    frame = segment.replace(_ESCAPED_FLAG, FLAG).replace(_ESCAPED_ESCAPE, ESCAPE)
    return frame if len(frame) == len(segment) - segment.count(ESCAPE) else b""


def encode(body: bytes, checksum: str = SHIPPED) -> bytes:
    """Return one frame for the Teensy from header and payload, 4 to 36 bytes.

    It has an opening and a closing flag of its own: the Teensy's receiver shares none.
    """
    if checksum == CORRECTED:
        # The one's-complement sum, as ``feed`` explains; a header is never all zeros.
        return FLAG + _escape(body + bytes((0xFE - (sum(body) - 1) % 0xFF,))) + FLAG
    # The shipped receiver adds the bytes on the wire, without an escape's 7d or a carry. It would add an escaped
    # checksum as another value than the one that it stands for. So where the checksum would be 7d or 7e, the reserved
    # byte (0) is sent as ``7d 20``: this adds 20 to the sum and moves the checksum away from both.
    stuffed = _escape(body)
    chk = _shipped_checksum(stuffed)
    if chk in b"\x7d\x7e":
        stuffed = _escape(body[:3]) + bytes((0x7D, body[3] ^ _FLIP)) + _escape(body[4:])
        chk = _shipped_checksum(stuffed)
    return FLAG + stuffed + bytes((chk,)) + FLAG


def _shipped_checksum(stuffed):
    return 0xFF - (sum(stuffed) - 0x7D * stuffed.count(ESCAPE)) % 256


def _escape(data):
    return data.replace(ESCAPE, _ESCAPED_ESCAPE).replace(FLAG, _ESCAPED_FLAG)
