"""Random rooms with people, close rooms and empty ones, as depth cameras read them."""
