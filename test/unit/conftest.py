"""How hypothesis works for all unit tests: the same cases on every run, no stopwatch, and no file in the checkout."""
import os
import tempfile

from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir

if "HYPOTHESIS_STORAGE_DIRECTORY" not in os.environ:
    set_hypothesis_home_dir(os.path.join(tempfile.gettempdir(), f"hypothesis-{os.getuid()}"))
settings.register_profile("car_interface", database=None, deadline=None, derandomize=True)
settings.load_profile("car_interface")

# What ``./dev test`` leaves out where it runs the same tests on a second Python.
MARKS = ("once: takes long, and comes out the same with every Python: one of them is enough",
         "browser: looks at a page in a real browser")


def pytest_configure(config):
    for mark in MARKS:
        config.addinivalue_line("markers", mark)
