"""Building blocks of the window: theme, layouts, dialogs, overlay."""
