"""Plans of measurements, readings, their split into calibration and validation, and error metrics."""
