"""The version of this package, which only package.xml says."""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from xml.etree import ElementTree

UNKNOWN = "unknown"


def find_version() -> str:
    """The version of what is imported: a checkout's package.xml says it, else what pip or catkin has installed.

    A checkout comes first, since an older installation may be on the path as well.

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
