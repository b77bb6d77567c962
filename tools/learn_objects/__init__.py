"""Learn from scenes with truth which borders part objects, and what an object looks like."""
