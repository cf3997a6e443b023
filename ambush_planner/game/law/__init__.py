"""The most unpredictable strategies at the value of a game."""
