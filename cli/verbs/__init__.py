"""The verbs of the command, by topic."""
