"""What recorded departures say, read back and held against the planner."""
