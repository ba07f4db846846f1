"""From a session to a calibrated model with credible intervals."""
