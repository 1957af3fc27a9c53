# SPDX-License-Identifier: BSD-3-Clause
"""Digests of sources: results that are kept belong to the version of the code that made them."""

import hashlib
from pathlib import Path
from types import ModuleType


def source_digest(*modules: ModuleType) -> str:
    """SHA-256 of all files of packages and modules."""
    digest = hashlib.sha256()
    for module in modules:
        folders = [Path(folder) for folder in getattr(module, "__path__", [])]
        files = [path for folder in folders for path in folder.rglob("*.py")] or [Path(str(module.__file__))]
        for path in sorted(files):
            digest.update(path.read_bytes())
    return digest.hexdigest()
