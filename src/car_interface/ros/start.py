"""How a script starts its node: quiet from the first moment.

Importing rospy takes a few tenths of a second. A Ctrl-C in between ends the process without a word, not with a
traceback; ``ros.runtime.run`` then installs handlers of its own.
"""
from __future__ import annotations

import importlib
import signal


def start(module: str) -> None:
    """Run ``main`` of ``car_interface.<module>``."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    importlib.import_module(f"car_interface.{module}").main()
