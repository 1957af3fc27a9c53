"""Direct Sparse Odometry: from images to poses."""

from typing import Optional

import numpy as np

from ceiling_dso_ros.dso.camera import PinholeCamera
from ceiling_dso_ros.dso.config import OdometryConfig
from ceiling_dso_ros.dso.status import OdometryStatus, TrackingState


class DirectOdometry:
    """Tracks a camera over a stream of images."""

    def __init__(self, camera: PinholeCamera, config: OdometryConfig = OdometryConfig()) -> None:
        config.check()
        self.camera = camera
        self.config = config

    def track(self, image: np.ndarray, stamp_s: float, exposure_ms: Optional[float] = None) -> OdometryStatus:
        """Process one image.

        Args:
            image: (height, width) float32 or uint8, undistorted and photometrically corrected, grey levels 0..255.
            stamp_s: seconds, larger than the last one's.
            exposure_ms: exposure time, None or not positive when unknown.
        """
        return OdometryStatus(stamp_s, TrackingState.INITIALIZING, 0, message="not built yet")

    def reset(self) -> None:
        """Forget everything: the next image starts segment 0."""
