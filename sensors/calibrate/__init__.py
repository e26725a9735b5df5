"""A rig's calibration from views of a hole plate."""
