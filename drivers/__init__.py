"""Instruments of a coil rig, behind the protocols of `drivers.protocols`; without torch or `estimator`."""
