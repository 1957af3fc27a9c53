# SPDX-License-Identifier: BSD-3-Clause
"""All faults by name."""

from typing import Dict

from support.faults import (
    camera_faults,
    machine_faults,
    process_faults,
    surroundings_faults,
    time_faults,
    wheel_faults,
)
from support.faults.outcome import Fault

PARTS = (camera_faults, wheel_faults, time_faults, process_faults, machine_faults, surroundings_faults)
FAULTS: Dict[str, Fault] = {name: fault for part in PARTS for name, fault in part.FAULTS.items()}
