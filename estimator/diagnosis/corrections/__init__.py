"""Corrections for what is left where no known cause explains it."""
