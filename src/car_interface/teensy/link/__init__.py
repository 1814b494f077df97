"""The serial link to the Teensy: framing, records, port, pings, health.

All but ``port`` and ``console`` is pure: bytes and ``now_ns`` in, values out.
"""
