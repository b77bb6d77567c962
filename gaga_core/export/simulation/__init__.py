"""Objects that a simulator takes: bodies of splats, their files (MJCF, URDF, OpenUSD), a fall."""
