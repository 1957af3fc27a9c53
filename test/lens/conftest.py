# SPDX-License-Identifier: BSD-3-Clause
"""Makes the modules beside this file importable from the tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
