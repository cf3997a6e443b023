# SPDX-License-Identifier: Apache-2.0
"""Give a command of a document the same entropy in each run, but no two commands the same.

Folders in its arguments differ between runs.
"""

import random
import secrets
import sys

words = [each.rpartition('/')[2] for each in sys.orig_argv[2:]]
secrets.randbits = random.Random(repr(words)).getrandbits
