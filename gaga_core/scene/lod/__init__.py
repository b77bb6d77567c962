"""Level of detail of large scenes: a tree of merged splats, and the cut of it that is drawn."""
