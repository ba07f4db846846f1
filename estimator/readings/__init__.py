"""What is to be read, what was read, which of it is kept out of a fit, and how far predictions are from it."""
