"""What commands do to a session: one module a subject of the menus, with its state."""
