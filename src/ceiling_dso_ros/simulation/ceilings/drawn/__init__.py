# SPDX-License-Identifier: BSD-3-Clause
"""Halls drawn at random: shape of the roof, what it is made of, what hangs there, and the light."""

from ceiling_dso_ros.simulation.ceilings.drawn.hall import random_hall

__all__ = ["random_hall"]
