"""The annotate-cloud command."""
