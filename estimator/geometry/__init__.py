"""From the readings of a mover to its pose."""
