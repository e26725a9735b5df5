"""Numbers that one set of labels earns against another."""
