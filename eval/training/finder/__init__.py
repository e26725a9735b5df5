"""Training of the person finder on rooms and on the virtual rig."""
