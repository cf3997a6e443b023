# SPDX-License-Identifier: Apache-2.0
"""From a request to a plan: map, start, goal and options yield a strategy for each leg.

``options`` has what a plan takes, ``plan`` the records and a departure's routes and path; ``trip``
makes the plan, with or without stops, and ``refinement`` its finer networks. ``evaluation``
compares with fixed routes, ``changed_ground`` judges a plan on a map that has changed,
``clear_ground`` what can be driven there, ``moved_start`` joins a plan from elsewhere.
"""
