"""Report pages and plots; what they report comes from other packages."""
