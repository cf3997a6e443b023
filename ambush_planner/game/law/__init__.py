"""The law of routes: the most unpredictable strategy within limits, on an acyclic network."""
