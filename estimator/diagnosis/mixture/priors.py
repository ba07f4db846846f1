"""What is supposed before the readings are seen: how many things are wrong, of what kind, and how large they are."""

from __future__ import annotations

EMPTY = 0.7  # of a slot
LISTED = 0.25
DEPARTURE = 0.05
WIDTHS = ((0.1, 0.15), (0.3, 0.25), (1.0, 0.4), (3.0, 0.13), (10.0, 0.07))
"""Factors on the stated width of a listed cause, and their probabilities. Most things are smaller than they may be, and some are larger: a
probe has elements 2 mm apart where 0.5 mm is stated."""
AMPLITUDES = (0.5, 2.0, 8.0, 30.0)
"""Rms of a departure in units of the noise, alike probable: factors of four, so that any lies within a factor of two of one."""
