"""Structure of a residual, before any cause is named."""
