"""Training of the reader of suits."""
