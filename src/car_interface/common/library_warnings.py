"""Keeps from the terminal what numpy, scipy and matplotlib tell their programmers.

A warning of theirs is no line of ours: it names no cause that a user could mend. The tests turn each one that they can
provoke into an error, so that its cause is mended; this is for those of other versions. ``python3 -W default`` shows
them.
"""
from __future__ import annotations

import logging
import os
import sys
import warnings


def hide_warnings() -> None:
    """Hide them in this process. To be called before these libraries are imported."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    # It also logs: that it builds its cache of fonts, that its folder can't be written, a typo in a matplotlibrc.
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)
    os.environ["MPLBACKEND"] = "Agg"  # one that isn't installed, such as a notebook's, would end the import
