"""Which readings would tell causes apart or shrink a parameter."""
