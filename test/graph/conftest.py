"""What the tests in the graph share."""
import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from car import Car
from graph import Graph

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(ROOT / "demo"), str(ROOT / "test" / "process")]


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch):
    """No node reads keys."""
    monkeypatch.setattr(sys, "stdin", None)


@pytest.fixture
def graph():
    return Graph()


@pytest.fixture
def car():
    return Car()


@pytest.fixture(scope="module")
def forker():
    """A process of one thread, for tests that fork: pytest's own workers have several."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        with pytest.MonkeyPatch.context() as patch:
            # catkin has put the package's src first, which in a new process hides the generated messages.
            patch.setattr(sys, "path", [*os.environ["PYTHONPATH"].split(os.pathsep), *sys.path])
            process.submit(int).result()
        yield process
