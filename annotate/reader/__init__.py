"""Reader of suits: one network names every pixel's part, from what geometry, warmth and colour say of it."""
