# SPDX-License-Identifier: Apache-2.0
"""The demo, ``python -m examples.demo``: a real node on real terrain."""
