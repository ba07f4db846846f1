"""What is known of a set-up: bodies, parameters with priors, and the vector that a fit moves."""
