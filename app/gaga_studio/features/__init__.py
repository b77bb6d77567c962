"""What commands do to a session: one module a topic of the menus."""
