# SPDX-License-Identifier: BSD-3-Clause
"""Simulates a robot under a ceiling with its camera, wheels and other sensors: from Python, or into a bag."""
