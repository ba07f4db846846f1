"""Acquisition of a session with instruments: the stops of a plan, one after the other, into a journal."""
