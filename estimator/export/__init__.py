"""Calibrations leave the house: files that other programs read, one module for each format."""
