"""From what a mover reports to where it stands."""
