"""Results of comparisons as one self-contained HTML page."""
