"""The demo scene, made by our own code."""
