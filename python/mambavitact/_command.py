"""The command `mambavitact`: the same program as the one that Cargo builds."""

import signal
import sys
import sysconfig
from pathlib import Path

from mambavitact import _native


def main() -> int:
    """Run the program with the arguments of this process."""
    # The program handles Ctrl-C itself; Python could do so only after its end.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    program = Path(sys.argv[0])
    if program.name != "mambavitact":
        # Started as a module: the program starts itself again for the window, by the installed command.
        program = Path(sysconfig.get_path("scripts")) / "mambavitact"
    return _native.main([str(program), *sys.argv[1:]])
