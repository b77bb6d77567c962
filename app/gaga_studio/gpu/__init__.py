"""The only code that touches OpenGL; no ImGui."""
