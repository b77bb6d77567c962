"""From photos and films to cameras: structure from motion, and its checks (section 3.1)."""
