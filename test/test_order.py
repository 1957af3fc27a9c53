# SPDX-License-Identifier: BSD-3-Clause
"""In which order the tests run beside each other."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

FILES = {
    "test_many.py": "def test_a(): pass\ndef test_b(): pass\ndef test_c(): pass\n",
    "test_some.py": "def test_a(): pass\ndef test_b(): pass\n",
    "test_slow.py": "import pytest\n@pytest.mark.long(minutes=9)\ndef test_a(): pass\n",
    "test_slower.py": "import pytest\n@pytest.mark.long(minutes=10)\ndef test_a(): pass\n",
}


def test_the_longest_files_come_first(tmp_path):
    """Whatever their number of tests, by which pytest-xdist would sort them."""
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = long\n")
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    words = [
        sys.executable,
        "-m",
        "pytest",
        "--numprocesses",
        "1",
        "--dist",
        "loadfile",
        "-v",
        "-p",
        "no:cacheprovider",
    ]
    result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    order = re.findall(r"PASSED (\w+\.py)", result.stdout)
    assert list(dict.fromkeys(order)) == ["test_slower.py", "test_slow.py", "test_many.py", "test_some.py"]
