"""2D masks on disk: our label maps, and masks of other programs."""
