# SPDX-License-Identifier: BSD-3-Clause
"""`python3 -m ceiling_dso_ros COMMAND ...`."""

from ceiling_dso_ros.cli.main import run_process

if __name__ == "__main__":
    run_process()
