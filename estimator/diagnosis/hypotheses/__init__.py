"""Causes that could explain a residual, and the evidence for each."""
