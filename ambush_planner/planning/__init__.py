"""From a request to a plan: a map, two places and options give a strategy with its corridors.

``plan`` has the records and a departure's route and path; ``trip`` makes the plan, with stops or
without. ``many`` solves many problems at once, ``frontier`` many budgets. ``evaluation`` compares
with fixed routes, ``changed_ground`` follows changes of the map, ``parameters`` has all options.
"""
