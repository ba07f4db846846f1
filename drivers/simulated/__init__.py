"""Simulated rig: each instrument runs in its own process behind the real protocol, and all share one world."""
