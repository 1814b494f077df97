"""What holds for all tests by pytest: test/unit and test/graph.

Hypothesis takes the same cases on every run, without a stopwatch, and without a file in the checkout. With
CAR_INTERFACE_ALL, as in `./dev test --all`, it takes others on every run, by the seed that test/run.py prints; what
fails there is kept as an `@example`. In a run of `./dev test` a test that hangs fails, and the others run.

A second Python runs what can differ there: syntax, the standard library, and other versions of numpy, matplotlib,
rosbags, tornado and PyYAML. Once is enough for what takes long and is arithmetic (drives of virtual cars, faults in
each phase of the timers, fits), for what only reads the checkout, and for the tests of the test runner: that runs on
the system's Python alone. The short tests of the same module or node run on both, so that each module's code is run on
both. What runs the same lines again does so there with --all only: another case of a test than its first, more than a
few examples of a property, and what is marked `more`: another whole page of a drive, another whole car.
"""
import gc
import os
import signal
import tempfile

import pytest
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir

if "HYPOTHESIS_STORAGE_DIRECTORY" not in os.environ:
    set_hypothesis_home_dir(os.path.join(tempfile.gettempdir(), f"hypothesis-{os.getuid()}"))
IS_RANDOM = bool(os.environ.get("CAR_INTERFACE_ALL"))
settings.register_profile("car_interface", database=None, deadline=None, derandomize=not IS_RANDOM)
settings.register_profile("few", settings.get_profile("car_interface"), max_examples=10)
settings.load_profile("car_interface")

# What ``./dev test`` leaves out where it runs the same tests on a second Python: the mark, or one of these files.
ONCE = ("test_documentation", "test_layering", "test_noise", "test_packaging", "test_run", "test_safety_case",
        "test_set_up", "test_tally", "test_virtual_drives")
MARKS = ("once: takes long, and comes out the same with every Python: one of them is enough",
         "more: the same lines again; on a second Python with --all only",
         "browser: looks at a page in a real browser")


# The longest test takes some 10 s on an idle machine.
LIMIT_S = float(os.environ.get("CAR_INTERFACE_UNIT_LIMIT_S", "600"))


@pytest.fixture(autouse=True)
def unknown_computer(monkeypatch):
    """The tests run on a computer of no known kind, also where that is a Raspberry Pi or a Jetson."""
    monkeypatch.setattr("car_interface.common.devices.MODEL_FILE", os.devnull)


def pytest_configure(config):
    gc.disable()  # while modules and tests are collected, which all stay: a quarter of that time
    for mark in MARKS:
        config.addinivalue_line("markers", mark)
    if hasattr(config, "workerinput"):  # of pytest-xdist: who runs pytest alone may be debugging
        signal.signal(signal.SIGALRM, _raise_hung)


def pytest_collection_modifyitems(items):
    files = {os.path.join(os.path.dirname(__file__), "unit", f"{name}.py") for name in ONCE}
    seen = set()
    for item in items:
        if str(item.fspath) in files:
            item.add_marker(pytest.mark.once)
        test = item.nodeid.partition("[")[0]
        if test in seen:
            item.add_marker(pytest.mark.more)
        seen.add(test)


def pytest_collection_finish():
    gc.enable()
    gc.freeze()  # so that each collection of garbage doesn't go through all modules and tests
    gc.set_threshold(7_000)  # ten times the default: a virtual drive leaves little garbage, and takes 5 % less so


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    if hasattr(item.config, "workerinput"):
        signal.setitimer(signal.ITIMER_REAL, LIMIT_S, LIMIT_S)  # again if its teardown hangs, too
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)


class Hung(BaseException):
    """A test took too long. Not an Exception: hypothesis would run the same case again."""


def _raise_hung(*_):
    raise Hung(f"hung: ended after {LIMIT_S:.0f} s")
