"""What is open and what panels read: no toolkit, no OpenGL; works without a window."""
