# SPDX-License-Identifier: BSD-3-Clause
"""Many runs: drives that are rendered and tracked once, and their errors against the ground truth."""
