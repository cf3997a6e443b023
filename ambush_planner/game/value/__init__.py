# SPDX-License-Identifier: Apache-2.0
"""Programs for the least value, with an ambusher's strategy that certifies it.

They are the master problems of constraint generation: sites are added when they are violated.
"""
