"""Power supplies: the commands of each model, and the source that ramps them."""
