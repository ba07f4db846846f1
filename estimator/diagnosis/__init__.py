"""From a fitted session to a verdict: possible causes, the evidence for each, and what remains unexplained."""
