"""What the tests in the graph share."""
import sys
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
