"""Colours of pictures and reports; colour-blind readers can distinguish them."""

OBSTACLE = '#1c1714'
AMBUSHER = '#e66100'
# Paul Tol's vibrant and muted colour schemes without orange, the ambusher's colour, and greys.
ROUTES = ('#0077bb', '#cc3311', '#009988', '#ee3377', '#332288', '#33bbee', '#117733', '#882255')
