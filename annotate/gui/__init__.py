"""The correction window: Qt and VTK are imported inside this package alone."""
