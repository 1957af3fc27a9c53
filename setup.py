# SPDX-License-Identifier: BSD-3-Clause
"""What catkin and pip both need; pyproject.toml has the rest. Not to be called by hand: use catkin or pip."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

# catkin_pkg, which could read this too, is missing where there is no ROS.
package = ElementTree.parse(Path(__file__).with_name("package.xml"))
setup(
    name=package.findtext("name"),
    version=package.findtext("version"),
    packages=find_packages("src"),
    package_dir={"": "src"},
)
