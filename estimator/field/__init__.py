"""Magnetic field of coils, from one filamentary loop to windings summed over several coils."""
