"""The scene folder: its layout, locks, staged results, child processes."""
