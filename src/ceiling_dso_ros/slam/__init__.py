# SPDX-License-Identifier: BSD-3-Clause
"""The map of a site: keyframe records, finding places again, verification, pose graph, map files."""
