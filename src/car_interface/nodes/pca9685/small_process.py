"""Runs a module's ``main`` in an interpreter of its own without site packages: it starts quickly and stays small.

As a program: ``python3 -S -I small_process.py MODULE ARGUMENT...``. It imports the
package by the place of this file, whatever the user's environment and the folder that it runs in.
"""
from __future__ import annotations

import os
import sys


def command(module: str, *arguments: str) -> list:
    """Return the command that runs ``main`` of ``car_interface.<module>``, on this interpreter."""
    options = ["-B"] if sys.dont_write_bytecode else []
    if sys.pycache_prefix is not None:
        options += ["-X", f"pycache_prefix={sys.pycache_prefix}"]
    return [sys.executable, "-S", "-I", *options, os.path.abspath(__file__), f"car_interface.{module}", *arguments]


def main() -> None:
    """Run the module that the command line names; its ``main`` finds its arguments in ``sys.argv[1:]``."""
    package = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    sys.path.insert(0, os.path.dirname(package))
    del sys.argv[0]
    __import__(sys.argv[0])
    sys.modules[sys.argv[0]].main()


if __name__ == "__main__":
    main()
