"""From a risk map to the network that the game is played on.

``node_sampling`` says where nodes lie, ``connectivity`` which of them are joined, ``layout`` which
of these edges are on free ground; ``construction`` puts them together and ``passages`` finds gaps
narrower than the mesh. ``network`` is the record, ``hiding_places`` adds sites in obstacles.
"""
