"""Labels by colour: a 2-D pose network, alone or with the suit."""
