"""Says what there is to install: to catkin, and to pip for a laptop without ROS (pip install '.[tools]').

What both need to know of the package stands in package.xml.
"""
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

# From the last version for Python 3.8 to the newest that was tested: tools/recordings/recording.py overrides an
# undocumented part of its reader. package.xml has the same range.
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
    packages=find_packages(str(HERE / "src")),
    package_dir={"": "src"},
    package_data={"car_interface.tools.report": ["templates/*"], "car_interface.nodes.phone_drive": ["page/*"]},
    data_files=[files("msg", "*.msg"), files("config", "*.yaml"), files("config", "*.csv")],
    extras_require={"tools": ["Jinja2", "matplotlib", "numpy", "PyYAML", ROSBAGS, "scipy", "tqdm"],
                    "cluster": ["distributed>=2023.5.0"]},  # the last for Python 3.8
    entry_points={"console_scripts": ["car-interface = car_interface.tools.cli.main:main"]},
)
