"""What the tests in the graph share."""
import multiprocessing
import sys
from pathlib import Path

import pytest

from car import Car
from graph import Graph

sys.path.append(str(Path(__file__).resolve().parents[2] / "demo"))


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
    """A pool with one process of one thread, for tests that fork: pytest's own workers have several."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        yield pool
