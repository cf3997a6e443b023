"""From a request to a plan: map, start, goal and options yield a strategy with its corridors.

``plan`` has the records and a departure's route and path; ``trip`` makes the plan, with or without
stops. ``many`` solves many problems at once, ``frontier`` many budgets; ``holding``: what to hold.
``evaluation`` compares with fixed routes, ``changed_ground`` follows changes of the map,
``parameters`` has all options.
"""
