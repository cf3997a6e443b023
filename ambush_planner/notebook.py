# SPDX-License-Identifier: Apache-2.0
"""Text and HTML representations of result records."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np


class Shown:
    """Result record with a one-line repr, without the contents of its arrays."""

    def _summary(self) -> dict[str, str]:
        """Return what is shown, as text, by its names: by default all fields."""
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {field.name: _brief(getattr(self, field.name)) for field in fields if field.repr}

    def __repr__(self) -> str:
        numbers = ', '.join(f'{name} {text}' for name, text in self._summary().items())
        return f'{type(self).__name__}({numbers})'

    def _repr_html_(self) -> str:
        rows = ''.join(f'<tr><th>{name}</th><td>{text}</td></tr>'
                       for name, text in self._summary().items())
        return f'<table>{rows}</table>'


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f'{value.dtype}{list(value.shape)}'
    if isinstance(value, Shown):
        return f'{type(value).__name__}(...)'
    text = repr(value)
    return text if len(text) < 60 else f'{type(value).__name__}(...)'
