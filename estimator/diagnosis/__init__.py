"""From a fitted session to a verdict: what could be wrong, what evidence there is for it, and what is left."""
