"""The route of a departure and the poses of its path."""

from __future__ import annotations

import secrets

import numpy as np

from ..arrays import FloatArray
from ..planning.plan import Route, depart, departure_path
from .plan_cache import Fit


def route_entropy_source(seed: int, departure: int) -> list[int]:
    """Return the seed of one departure's random generator.

    With seed -1 this is 256 bits from the operating system. With a fixed seed it follows from the
    number of the departure, so that each route can be reproduced on its own. Nothing else goes in:
    no time, no input.
    """
    return [secrets.randbits(256)] if seed < 0 else [seed, departure]


def draw_path(fit: Fit, source: list[int], spacing: float) -> tuple[Route, FloatArray] | None:
    """Draw a route that is clear on the trip's map, and its path (L, 3) = (x, y, yaw) [m, m, rad].

    ``source`` seeds the random generator. Poses are at most ``spacing`` [m] apart; 0: as far as the
    plan says. None if hardly any route is clear.
    """
    rng, newest, ends = np.random.default_rng(source), fit.trip.map, fit.cached.ends(fit.trip)
    if fit.joined:
        route, plan = depart(fit.joined.plan, rng), fit.joined.plan
    else:
        clear = fit.cached.ground.draw(rng, newest)
        if clear is None:
            return None
        route, plan = clear, fit.cached.ground.fitted(newest, ends)
    return route, departure_path(plan, route, spacing or plan.spacing, ends)
