"""Who is in the cloud: the person apart from the room, the furniture and other people."""
