"""Two captures of one place: brought together, and what differs between them."""
