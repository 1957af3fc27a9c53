# SPDX-License-Identifier: BSD-3-Clause
"""Exposure times of Intel's driver realsense-ros: realsense2_camera/Metadata has a header and a text in JSON."""

import json
from typing import Optional

TYPE = "realsense2_camera/msg/Metadata"
DEFINITION = "std_msgs/Header header\nstring json_data"
LONGEST_MS = 200.0


def exposure_in_metadata(json_data: str) -> Optional[float]:
    """Exposure time in milliseconds; None if the text does not have it, as where the kernel does not pass it on."""
    try:
        fields = json.loads(json_data)
    except (ValueError, RecursionError):
        return None
    exposure_us = fields.get("actual_exposure") if isinstance(fields, dict) else None
    if not isinstance(exposure_us, (int, float)) or isinstance(exposure_us, bool):
        return None
    return exposure_us / 1e3 if 0.0 < exposure_us <= 1e3 * LONGEST_MS else None
