"""Live labelling of a running rig: its newest moment labelled, and warnings about what is wrong."""
