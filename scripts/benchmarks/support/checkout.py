# SPDX-License-Identifier: BSD-3-Clause
"""Where the checkout is, and the shared recordings beside it."""

import os
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("CEILING_DSO_DATA", CHECKOUT.parent / "shared" / "data"))
