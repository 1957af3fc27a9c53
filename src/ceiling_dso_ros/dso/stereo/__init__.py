# SPDX-License-Identifier: BSD-3-Clause
"""A second camera beside the first: its images tell how many metres a unit of the map is."""
