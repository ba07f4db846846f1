"""From readings to parameters: likelihood, point estimate, Laplace approximation, posterior sampling and convergence."""
