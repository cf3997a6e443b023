# SPDX-License-Identifier: Apache-2.0
"""From a drawn route to the path to drive.

``corridors`` limits how far the path may leave the route, ``cut_corners`` shortens the route if no
ambush gains by it, ``taut_string`` finds the shortest line within these, and ``driven_path`` rounds
its corners. ``corridor_update`` adapts corridors to map changes. ``legs`` and ``way_points``
describe a path to its driver; ``shared_roads`` helps pictures of several paths.
"""
