"""Robot arms: reading poses and moving."""
