"""A drive of a minute in which a lot happens, and its summary."""
import pytest

from car_interface.tools.report.plots import plots
from car_interface.tools.report.summary import summarize
from written_recordings import drive, write_ros1


@pytest.fixture(scope="session")
def bag(tmp_path_factory):
    """A drive of a minute in which a lot happens, as a ROS 1 bag."""
    return str(write_ros1(tmp_path_factory.mktemp("bags") / "drive.bag", drive()))


@pytest.fixture(scope="session")
def seen(bag):
    return summarize(bag)


@pytest.fixture(scope="session")
def drawn(seen):
    return plots(seen)
