"""Factors between units of time. Times inside the package are ``int`` nanoseconds."""
from __future__ import annotations

NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000
