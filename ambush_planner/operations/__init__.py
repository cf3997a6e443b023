# SPDX-License-Identifier: Apache-2.0
"""Uses of plans beyond departures; no plan depends on them.

``few_routes`` has the best mixture of a few routes, ``judge`` judges trips that were driven, both
by ``path_mixtures``; ``slots`` mixes times of departure, ``hold`` finds places to secure. ``many``
solves many problems at once, ``frontier`` many budgets.
"""
