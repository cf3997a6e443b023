"""From a drawn route to the path to drive, and the joint routes of several convoys.

``corridors`` limits how far the path may leave the route, ``taut_string`` finds the shortest line
within them, and ``driven_path`` rounds its corners. ``corridor_update`` adapts corridors to map
changes. ``days`` draws the routes of several convoys of one day.
"""
