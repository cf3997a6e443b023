# SPDX-License-Identifier: Apache-2.0
"""Give a command of a document the same entropy in each run, but no two commands the same."""

import random
import secrets
import sys

secrets.randbits = random.Random(repr(sys.orig_argv[2:])).getrandbits
