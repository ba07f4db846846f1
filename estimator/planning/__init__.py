"""Plans of measurements before any reading, and stops that are chosen while one goes on."""
