# SPDX-License-Identifier: BSD-3-Clause
"""Prints each test of JUnit files that failed, with its message and the end of its traceback."""

import sys
from pathlib import Path
from xml.etree import ElementTree

LINES = 25  # of a traceback; what raised is at its end


def main(folder: Path) -> None:
    """Print what failed in the files below a folder."""
    for path in sorted(folder.rglob("*.xml")):
        for case in ElementTree.parse(path).iter("testcase"):
            for fault in [*case.iter("failure"), *case.iter("error")]:
                print(f"{path.stem}: {case.get('name')}: {fault.tag}: {fault.get('message') or fault.get('type')}")
                print("\n".join("    " + line for line in (fault.text or "").rstrip().splitlines()[-LINES:]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
