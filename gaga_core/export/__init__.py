"""Writing results: splats, meshes, colliders, cameras, a web page."""
