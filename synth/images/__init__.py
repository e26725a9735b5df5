"""Single depth images with part labels, and datasets of them."""
