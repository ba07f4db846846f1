"""What is kept on disk: sessions of readings, chains while they grow, calibrations; all zarr v3 with checksummed chunks."""
