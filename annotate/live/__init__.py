"""Live labelling of a running rig, with warnings."""
