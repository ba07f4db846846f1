"""Causes of a difference between simulation and measurement, by what they belong to."""
