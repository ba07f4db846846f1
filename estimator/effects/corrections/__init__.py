"""Corrections for what is left without a known cause: smooth fields, responses and functions of time, each where it acts."""
