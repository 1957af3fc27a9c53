# SPDX-License-Identifier: BSD-3-Clause
"""From the description of a hall to images: geometry, materials, light, and the renderer."""
