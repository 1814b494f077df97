"""Tells catkin which Python packages to install; catkin runs it, nobody else should."""
from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=[
            "car_interface",
            "car_interface.bags",
            "car_interface.doctor",
            "car_interface.nodes",
            "car_interface.pca9685",
            "car_interface.sim",
            "car_interface.teensy",
        ],
        package_dir={"": "src"},
    )
)
