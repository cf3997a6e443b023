# SPDX-License-Identifier: Apache-2.0
"""Plain networks, which plans do not refine: tests of something else are quick on them."""

from ambush_planner import NetworkOptions


def plain_options(**options) -> NetworkOptions:
    """Options of a plain network."""
    return NetworkOptions(refine=0, **options)
