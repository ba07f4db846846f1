"""Several coils, each calibrated with the others off, as one field."""
