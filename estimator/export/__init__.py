"""Export of calibrations: files that other programs read, one module for each format."""
