"""Thermometers of coils and sensors."""
