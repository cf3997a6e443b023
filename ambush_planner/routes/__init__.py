"""From a drawn route to the path that is driven, and the routes of one day.

``corridors`` say how far the path may leave the route, ``taut_string`` finds the shortest line
through them, ``driven_path`` rounds its corners. ``corridor_update`` follows changes of the map.
``days`` draws the departures of several convoys together.
"""
