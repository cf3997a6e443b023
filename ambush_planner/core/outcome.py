"""What a solver hands on: the two players' strategies, not yet certified."""

from __future__ import annotations

from dataclasses import dataclass

from .risk_map import FloatArray


@dataclass(frozen=True, eq=False)
class Outcome:
    """p (M,), q (N,), the length budget [m] and its price [loss / m], iterations."""

    p: FloatArray
    q: FloatArray
    budget: float
    length_price: float
    iterations: int
