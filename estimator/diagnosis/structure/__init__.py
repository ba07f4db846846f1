"""What a residual shows by itself, before any cause is named."""
