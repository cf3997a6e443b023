"""The judge: value and lower bound from a strategy and an ambusher alone."""
