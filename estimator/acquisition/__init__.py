"""Measuring a session with instruments."""
