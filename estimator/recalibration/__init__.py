"""How the periodic job judges a new session: agreement with the current version, widened priors, and the conclusion."""
