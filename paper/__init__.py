# SPDX-License-Identifier: Apache-2.0
"""Reproduction of E. Boidot and E. Feron, *Planning Random path distributions for ambush games*."""
