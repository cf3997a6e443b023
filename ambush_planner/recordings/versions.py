# SPDX-License-Identifier: Apache-2.0
"""The versions of the planner and of the software that it computes with."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType

import numpy as np
import scipy


@cache
def software_versions() -> Mapping[str, str]:
    """The versions of the planner and of the software that it computes with."""
    return MappingProxyType({'ambush_planner': _version_of('ambush_planner'),
                             'python': platform.python_version(), 'numpy': np.__version__,
                             'scipy': scipy.__version__, 'rclpy': _version_of('rclpy')})


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return 'not installed'
