"""Building blocks of all panels: theme, icons, widgets, textures of photos and masks."""
