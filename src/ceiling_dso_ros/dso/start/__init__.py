# SPDX-License-Identifier: BSD-3-Clause
"""The first map of a segment."""
