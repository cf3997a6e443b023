"""The commands, each one file."""
