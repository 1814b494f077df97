"""Bytes that are damaged at random: what a bad line, a torn file or a hostile peer makes of them."""
from __future__ import annotations

import random

PIECES = (b"", b"\0", b"nan", b"1e999", b"-", b": ", b"[" * 40, b"{", b"&a *a", b"!!python/object:os.system ", b"\n",
          b'"', b",", b"\xff\xfe", b"9" * 400, b"\t", b"#", b"<<: ", b"\x7e", b"\x7d", b"\x7e\x7e\x01\x02")


def damaged(data: bytes, choose: random.Random) -> bytes:
    """Some places of it lost, doubled, replaced or flipped, or all from one on lost."""
    for _ in range(choose.choice((0, 1, 1, 2, 4, 16))):
        start = choose.randrange(len(data) + 1)
        end = start + choose.choice((0, 1, 1, 1, 3, 30, 30, 30, choose.choice((1, len(data)))))
        flipped = bytes(byte ^ 1 << choose.randrange(8) for byte in data[start:end][:1])
        data = data[:start] + choose.choice((b"", data[start:end] * 2, choose.choice(PIECES), flipped, bytes(
            choose.choices(range(256), k=8)))) + data[end:]
    return data
