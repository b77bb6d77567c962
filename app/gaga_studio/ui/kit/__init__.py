"""What every panel is built of: theme, icons, widgets, textures of photos and masks."""
