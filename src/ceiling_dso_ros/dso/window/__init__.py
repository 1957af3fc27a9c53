# SPDX-License-Identifier: BSD-3-Clause
"""The window of keyframes: all state that is kept between images."""
