# SPDX-License-Identifier: Apache-2.0
"""From a map, a start, stops and a goal to a plan, and from a plan to departures.

``options`` has the options of a plan, ``trip`` makes it, ``solving`` solves its games, with ambush
sites at any cell (``cell_losses``), and ``refinement`` makes its network finer. ``plan`` is the
record, ``few`` that of a mixture of few routes; ``departure`` draws from either. ``concerns`` warns
about a plan, ``evaluation`` compares it with fixed routes, ``ambush_costs`` maps what ambushes
cost. ``changed_ground`` assesses a plan on a map that has changed, ``new_ground`` on another map;
``clear_ground`` says what can be driven there. ``moved_start`` joins a plan from elsewhere, and
``trip_under_way`` decides whether a request continues a trip.
"""
