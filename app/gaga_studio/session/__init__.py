"""The open scene and the state that panels read: no toolkit, no OpenGL, no window needed."""
