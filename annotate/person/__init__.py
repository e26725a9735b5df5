"""Persons in a cloud: detection, tracking, the subject, and checks of the thermal image."""
