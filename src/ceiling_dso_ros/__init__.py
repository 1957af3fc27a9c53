# SPDX-License-Identifier: BSD-3-Clause
"""Ceiling visual odometry for indoor industrial robots: Direct Sparse Odometry and wheel fusion."""

import os
from pkgutil import extend_path

# Must be set before numpy is loaded. All matrices here are small, and numpy's linear algebra threads would wait
# actively on the core that the tracking needs.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# catkin's devel space has a second folder of this package: the generated msg and cfg.
__path__ = extend_path(__path__, __name__)

from ceiling_dso_ros.version import find_version  # by __path__ alone in the devel space

__version__ = find_version()
