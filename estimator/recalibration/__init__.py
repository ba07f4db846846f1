"""The periodic job: agreement of a new session with the current calibration, a refit, a conclusion, and the registry."""
