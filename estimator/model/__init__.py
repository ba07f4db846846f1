"""The measurement model: from currents and poses to predicted readings, for fits, predictions and simulations alike."""
