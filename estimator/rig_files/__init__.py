"""YAML to rig and back."""
