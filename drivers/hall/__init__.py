"""Hall magnetometers with three axes."""
