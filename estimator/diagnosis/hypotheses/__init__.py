"""Which causes could explain a residual, and what evidence there is for each."""
