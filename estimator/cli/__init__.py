"""The command `coilcal`: options in, calls of the Python API, results out; no physics."""
