# SPDX-License-Identifier: BSD-3-Clause
"""Points of the map in the frames of their host keyframes."""

from dataclasses import dataclass
from typing import Mapping, Sequence

import numpy as np


@dataclass(frozen=True)
class HostedPoints:
    """Points relative to their host keyframes: they move when a host's pose is refined, even after they left.

    Attributes:
        keyframe_id: (N,) int64 host of each point.
        position_camera: (N, 3) float64 in the host's camera, VO units.
        grey: (N,) float32 grey level in the host.
    """

    keyframe_id: np.ndarray
    position_camera: np.ndarray
    grey: np.ndarray

    @classmethod
    def concatenated(cls, parts: Sequence["HostedPoints"]) -> "HostedPoints":
        """All points of some parts, of which there may be none."""
        if not parts:
            return NO_HOSTED_POINTS
        return cls(
            np.concatenate([part.keyframe_id for part in parts]),
            np.concatenate([part.position_camera for part in parts]),
            np.concatenate([part.grey for part in parts]),
        )

    def chosen(self, mask: np.ndarray) -> "HostedPoints":
        """Those whose mask, (N,) bool, is True."""
        return HostedPoints(self.keyframe_id[mask], self.position_camera[mask], self.grey[mask])

    def __len__(self) -> int:
        return len(self.keyframe_id)

    def positions_world(self, T_world_camera: Mapping[int, np.ndarray]) -> np.ndarray:
        """(N, 3) float64 in the VO world, VO units.

        Args:
            T_world_camera: keyframe -> its pose, (4, 4) float64, of all hosts at least.

        Raises:
            KeyError: the pose of a host is missing.
        """
        hosts, index = np.unique(self.keyframe_id, return_inverse=True)
        T = np.reshape([T_world_camera[host] for host in hosts.tolist()], (-1, 4, 4))[index]
        return np.einsum("nij,nj->ni", T[:, :3, :3], self.position_camera) + T[:, :3, 3]


NO_HOSTED_POINTS = HostedPoints(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.float32))
