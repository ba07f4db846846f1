"""Storage: sessions of readings, their journals while they are measured, and Markov chains, in zarr v3 with checksums."""
