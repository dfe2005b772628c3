"""The command `mambavitact`: the same program as the one that Cargo builds."""

import signal
import sys

from mambavitact import _native


def main() -> int:
    """Run the program with the arguments of this process."""
    # The program handles Ctrl-C itself; Python could do so only after its end.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _native.main(sys.argv)
