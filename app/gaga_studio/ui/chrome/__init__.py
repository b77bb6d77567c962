"""The frame of the window: menu, tool bar, status bar, toasts."""
