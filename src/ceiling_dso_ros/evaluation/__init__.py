# SPDX-License-Identifier: BSD-3-Clause
"""From a recording to a trajectory, and from a trajectory to its error."""
