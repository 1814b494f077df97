"""Hides the warnings of numpy, scipy and matplotlib, which are meant for programmers.

They name no cause that a user could mend. The tests turn each one that they can provoke into an error, so that its
cause is mended; this is for those of other versions. ``python3 -W default`` shows them.
"""
from __future__ import annotations

import logging
import os
import sys
import warnings


def hide_warnings() -> None:
    """Hide them in this process. Call it before these libraries are imported."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    # Matplotlib also logs that it builds its cache of fonts, a folder that can't be written, a typo in a matplotlibrc.
    logging.getLogger("matplotlib").setLevel(logging.CRITICAL)
    os.environ["MPLBACKEND"] = "Agg"  # a backend that isn't installed, such as a notebook's, would end the import
