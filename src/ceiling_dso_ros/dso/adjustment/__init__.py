# SPDX-License-Identifier: BSD-3-Clause
"""The bundle adjustment over the window, and the prior from marginalised keyframes and points."""
