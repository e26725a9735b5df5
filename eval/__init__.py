"""Networks, metrics, comparisons and the report."""
