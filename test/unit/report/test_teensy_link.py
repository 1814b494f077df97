"""The Teensy's counters."""
from __future__ import annotations


def test_counters_have_their_first_and_last_value(seen):
    assert seen.teensy.counters == {"txPackets": (0, 5900), "rxErrorChecksum": (7, 7)}
