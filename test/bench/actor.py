#!/usr/bin/env python3
"""One of the other processes of a measurement: ``actor.py ROLE ARGUMENT...``; roles.py has the roles."""
import importlib
import sys
from pathlib import Path

# In place of this folder: see __main__.py.
sys.path[0] = str(Path(__file__).resolve().parents[1])
importlib.import_module("bench.roles").main()
