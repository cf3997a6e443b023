"""From a request to a plan: a map, two places and options lead to a strategy with corridors.

``plan`` tells the story for one pair of places, ``trip`` for stops on the way, ``many`` for many
problems at once, ``frontier`` for many budgets. ``evaluation`` compares with fixed routes,
``changed_ground`` follows changes of the map, ``parameters`` names every option.
"""
