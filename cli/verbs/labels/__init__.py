"""The verbs that make labels and correct them."""
