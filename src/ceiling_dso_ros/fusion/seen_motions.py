# SPDX-License-Identifier: BSD-3-Clause
"""Motions that the camera saw between images and since the newest keyframe, in metres and beside the wheels."""

from dataclasses import replace
from typing import NamedTuple, Optional, Sequence

import numpy as np

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.dso.status import KeyframeEstimate, OdometryStatus
from ceiling_dso_ros.fusion import planar
from ceiling_dso_ros.fusion.backend import KeyframeBackend
from ceiling_dso_ros.fusion.config import VisualConfig
from ceiling_dso_ros.fusion.contradiction import has_moved
from ceiling_dso_ros.fusion.relative_filter import Sighting
from ceiling_dso_ros.fusion.twist_filter import MeanTwist
from ceiling_dso_ros.fusion.visual import VisualMotion
from ceiling_dso_ros.fusion.wheel_track import WheelTrack

LONGEST_GAP_S = 1.0  # images further apart are not compared


class SeenMotion(NamedTuple):
    """Motion between two images, stamped on the wheels' clock.

    Attributes:
        start_ns, end_ns: stamps of the images.
        visual: the motion.
        contradicted: by the wheels.
    """

    start_ns: int
    end_ns: int
    visual: VisualMotion
    contradicted: bool


class SeenMotions:
    """Relates tracked images to each other and to the newest keyframe.

    Args:
        backend: the graph, which has the scale and the keyframes.
        track: the wheels' motion of late.
        config: of the camera's noise.
        camera_offset_ns: what is added to the camera's stamps for those of the wheels.
    """

    def __init__(
        self, backend: KeyframeBackend, track: WheelTrack, config: VisualConfig, camera_offset_ns: int
    ) -> None:
        self._backend = backend
        self._track = track
        self._config = config
        self._camera_offset_ns = camera_offset_ns

    def between(self, before: OdometryStatus, after: OdometryStatus) -> Optional[SeenMotion]:
        """Motion between two images; None when they cannot be related, or are too far apart to be compared."""
        start_ns, end_ns = before.stamp_ns + self._camera_offset_ns, after.stamp_ns + self._camera_offset_ns
        if not 0.0 < seconds(end_ns - start_ns) < LONGEST_GAP_S:
            return None
        visual = self._backend.motion_between(before, after)
        if visual is None:
            return None
        contradicted = self._backend.wheels_contradict(self._track.motion(start_ns, end_ns), visual)
        return SeenMotion(start_ns, end_ns, visual, contradicted)

    def moves_again(self, images: Sequence[OdometryStatus], keyframe: KeyframeEstimate, doubted_since_ns: int) -> bool:
        """Whether a camera that is doubted has moved since its last image, and the newest node is older than the doubt.

        From before the doubt to now its motion is right in both cases: a robot that stood has not moved until now, a
        camera that was frozen sees all of the way at once.

        Args:
            images: those that were used, the newest last.
            keyframe: a new one.
            doubted_since_ns: on the wheels' clock.
        """
        if not images or self._backend.newest_ns > doubted_since_ns:
            return False
        last = images[-1]
        now = replace(last, keyframe_id=keyframe.keyframe_id, T_keyframe_camera=np.eye(4))
        visual = self._backend.motion_between(last, now)
        return visual is not None and has_moved(visual.base_motion(self._backend.scale.value))

    def speed(self, seen: SeenMotion) -> MeanTwist:
        """Mean forward speed and yaw rate between two images."""
        gap_s = seconds(seen.end_ns - seen.start_ns)
        rate = seen.visual.base_motion(self._backend.scale.value)[::2] / gap_s
        variances = np.diag(self._covariance(seen.visual))[::2] / gap_s**2
        return MeanTwist(self._track.end_ns, seen.start_ns, seen.end_ns, rate, np.diag(variances), of_wheels=False)

    def sighting(self, status: OdometryStatus) -> Optional[Sighting]:
        """Pose of the base relative to the newest keyframe, measured by the camera; None unless the scale is known."""
        visual = self._backend.motion_of(status) if self._backend.scale_known else None
        if visual is None:
            return None
        pose = visual.base_motion(self._backend.scale.value)
        return Sighting(status.stamp_ns + self._camera_offset_ns, pose, self._covariance(visual))

    def _covariance(self, visual: VisualMotion) -> np.ndarray:
        """(3, 3) covariance of the base's pose as the camera measures it, metres and rad."""
        scale = self._backend.scale.value
        metric = np.diag([scale, scale, 1.0])
        covariance = metric @ visual.noise(self._config) @ metric
        from_scale = self._backend.log_scale_sigma * scale * (planar.rotation(-visual.yaw) @ visual.shift)
        covariance[:2, :2] += np.outer(from_scale, from_scale)
        return covariance
