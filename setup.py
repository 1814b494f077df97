"""Says what there is to install: to catkin, and to pip for a laptop without ROS (pip install '.[tools]').

What both need to know of the package stands in package.xml.
"""
from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup

# From the last version for Python 3.8 to the newest that was tested: recordings/rosbag1.py overrides an undocumented
# part of its reader. package.xml has the same range.
ROSBAGS = "rosbags>=0.9.23,<=0.11.9"
HERE = Path(__file__).resolve().parent
PACKAGE = ElementTree.parse(str(HERE / "package.xml")).getroot()


def files(folder, pattern):
    """A folder's files for pip to put where common/package_files.py looks for them; catkin installs them by itself."""
    names = sorted(path.relative_to(HERE).as_posix() for path in (HERE / folder).glob(pattern))
    return f"share/car_interface/{folder}", names


setup(
    name=PACKAGE.findtext("name"),
    version=PACKAGE.findtext("version"),
    description=" ".join(PACKAGE.findtext("description").split()),
    author=PACKAGE.findtext("author"),
    maintainer=PACKAGE.findtext("maintainer"),
    maintainer_email=PACKAGE.find("maintainer").get("email"),
    license=PACKAGE.findtext("license"),
    python_requires=">=3.8",
    packages=[
        "car_interface",
        "car_interface.calibration",
        "car_interface.calibration.drive",
        "car_interface.calibration.esc",
        "car_interface.calibration.steering",
        "car_interface.calibration.value_map",
        "car_interface.cli",
        "car_interface.common",
        "car_interface.doctor",
        "car_interface.doctor.checks",
        "car_interface.doctor.probes",
        "car_interface.host_setup",
        "car_interface.interlock",
        "car_interface.nodes",
        "car_interface.pca9685",
        "car_interface.planner",
        "car_interface.recordings",
        "car_interface.report",
        "car_interface.ros",
        "car_interface.sim",
        "car_interface.steering",
        "car_interface.teensy",
        "car_interface.teensy.link",
        "car_interface.teensy.sensing",
        "car_interface.teleop",
        "car_interface.throttle",
    ],
    package_dir={"": "src"},
    data_files=[files("msg", "*.msg"), files("config", "*.yaml"), files("config", "*.csv")],
    extras_require={"tools": ["matplotlib", "numpy", "PyYAML", ROSBAGS, "scipy", "tqdm"]},
    entry_points={"console_scripts": ["car-interface = car_interface.cli.main:main"]},
)
