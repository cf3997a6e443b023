"""Reproduction of E. Boidot and E. Feron, *Planning Random path distributions for ambush games*."""
