"""The commands on a session: one module for each subject of the menus, with its state."""
