"""Robot arms: read poses and move."""
