"""Pages and plots, whatever they tell of."""
