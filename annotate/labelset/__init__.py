"""Label sets and datasets on disk: folders, images, journal, claims."""
