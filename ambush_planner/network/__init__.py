# SPDX-License-Identifier: Apache-2.0
"""From a risk map to the network that the game is played on.

``node_sampling`` places nodes, ``connectivity`` joins them, ``layout`` drops what obstacles block,
and ``construction`` puts these together. ``passages`` finds ways narrower than the node spacing.
``network`` defines the network; ``hiding_places`` adds ambush sites in obstacles.
"""
