# SPDX-License-Identifier: Apache-2.0
"""Unpredictable routes on a risk map, with a certified bound on the loss from an ambush.

The public names are those of ``public``, which is imported when one of them is used: that takes
most of a second, and commands refuse mistakes before.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # the module typing would be half of the start of a program
if TYPE_CHECKING:
    from typing import Any

    from .public import *  # noqa: F403

    __version__: str


def __getattr__(name: str) -> Any:
    if name == '__version__':
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version(__name__)
        except PackageNotFoundError:  # a checkout that was never installed
            return 'unknown'
    from importlib.util import find_spec

    # Modules of this package are no attributes before they are imported.
    if name != '__all__' and (name.startswith('_') or find_spec(f'{__name__}.{name}')):
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module('.public', __name__), name)


def __dir__() -> list[str]:
    return list(import_module('.public', __name__).__all__)
