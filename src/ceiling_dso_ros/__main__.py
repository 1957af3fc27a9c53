"""`python3 -m ceiling_dso_ros COMMAND ...`."""

import sys

from ceiling_dso_ros.cli.main import interrupt_on_signals, main

if __name__ == "__main__":
    interrupt_on_signals()
    sys.exit(main())
