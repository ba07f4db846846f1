"""Instruments of a coil rig, behind the protocols of `drivers.protocols`; without torch or `estimator`."""

DISTRIBUTION = "coilcal"  # which `coilcal` looks for, before another package of this name runs in its place
