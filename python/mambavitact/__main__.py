"""Makes `python -m mambavitact` the command `mambavitact`."""

import sys

from mambavitact._command import main

sys.exit(main())
