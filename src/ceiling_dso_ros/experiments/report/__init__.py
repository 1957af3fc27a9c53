# SPDX-License-Identifier: BSD-3-Clause
"""The results of a study as figures, tables and a page, and the comparison of two studies."""
