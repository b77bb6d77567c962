"""Long random use: of the session as a state machine, and of the window by events."""
