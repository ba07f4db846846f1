"""Whether a field map of a simulation, the coil model or neither explains the readings of a session."""
