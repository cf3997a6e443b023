# SPDX-License-Identifier: Apache-2.0
"""What plans are used for, beyond departures; no plan depends on it.

``few_routes`` has the best mixture of a few routes, ``judge`` judges trips that were driven, both
by ``path_mixtures``; ``slots`` mixes times of departure, ``hold`` finds what to hold. ``many``
solves many problems at once, ``frontier`` many budgets.
"""
