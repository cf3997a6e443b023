"""The least value of a game within its budgets, and an ambusher who proves it."""
