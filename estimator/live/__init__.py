"""Estimates while readings arrive."""
