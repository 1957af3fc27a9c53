"""Tells catkin where the Python package lies. Not to be called by hand: build with catkin."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(**generate_distutils_setup(packages=["ceiling_dso_ros"], package_dir={"": "src"}))
