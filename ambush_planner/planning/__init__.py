# SPDX-License-Identifier: Apache-2.0
"""From a request to a plan: map, start, goal and options yield a strategy with its corridors.

``options`` has what a plan takes, ``plan`` the records and a departure's route and path; ``trip``
makes the plan, with or without stops. ``few_routes`` has the best mixture of a few
routes, ``habits`` judges trips that were driven, both by ``path_mixtures``; ``slots`` mixes times
of departure, ``holding`` finds what to hold. ``many`` solves many problems at once, ``frontier``
many budgets. ``evaluation`` compares with fixed routes, ``changed_ground`` judges a plan on a map
that has changed, ``clear_ground`` what can be driven there.
"""
