# SPDX-License-Identifier: Apache-2.0
"""The program ``ambush``: one module for each command; ``cli`` has what they share.

To refuse mistakes at once, commands import all that computes inside functions; so they also print
their help without ROS. ``console`` prints, ``inputs`` reads maps and options.
"""

import signal
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``ambush``; Ctrl-C ends it with one line, also while it imports."""
    try:
        from . import cli

        return cli.main(arguments)
    except KeyboardInterrupt:
        print('ambush: interrupted', file=sys.stderr)
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback from the interpreter's exit
