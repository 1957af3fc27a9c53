# SPDX-License-Identifier: BSD-3-Clause
"""The version of this package; its only source is package.xml."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from xml.etree import ElementTree

UNKNOWN = "unknown"


def find_version() -> str:
    """The version of the imported package: from package.xml of a checkout, else from the installation by pip or catkin.

    A checkout is used first, because an older installation may be on the path, too.

    Returns:
        Three numbers with dots between them, or UNKNOWN for sources that were copied without package.xml.
    """
    manifest = Path(__file__).parents[2] / "package.xml"  # src/ceiling_dso_ros/version.py is where this is
    if manifest.is_file():
        return ElementTree.parse(manifest).findtext("version", UNKNOWN)
    try:
        return version("ceiling_dso_ros")
    except PackageNotFoundError:
        return UNKNOWN
