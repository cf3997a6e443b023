"""How records show themselves in a Python prompt and in a notebook."""

from __future__ import annotations

from abc import ABC, abstractmethod


class Shown(ABC):
    """A record that shows the numbers of its ``_summary()`` instead of its arrays."""

    @abstractmethod
    def _summary(self) -> dict[str, str]:
        """Return the numbers as text, by their names."""

    def __repr__(self) -> str:
        numbers = ', '.join(f'{name} {text}' for name, text in self._summary().items())
        return f'{type(self).__name__}({numbers})'

    def _repr_html_(self) -> str:
        rows = ''.join(f'<tr><th>{name}</th><td>{text}</td></tr>'
                       for name, text in self._summary().items())
        return f'<table>{rows}</table>'
