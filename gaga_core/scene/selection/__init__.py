"""Which splats: by picture, by value, by volume, by neighbourhood, by click."""
