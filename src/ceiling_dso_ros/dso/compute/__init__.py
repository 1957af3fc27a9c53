# SPDX-License-Identifier: BSD-3-Clause
"""Tools for the computation: compiled kernels, structs of arrays, linear systems, timers and threads."""
