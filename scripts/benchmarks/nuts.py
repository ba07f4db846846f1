"""The same readings, priors and field under NumPyro's NUTS, written in jax; real-valued loop counts.

Its coordinates are the logarithms of turns, length, thickness and noise, the mean radius and the pose, whitened by the Laplace
approximation, so that NUTS starts with the same knowledge as coilcal's moves.
"""

from __future__ import annotations

import math
import time

import jax
import jax.numpy as jnp
import numpy as np
import torch
from jax.scipy.spatial.transform import Rotation
from numpyro.infer import MCMC, NUTS

from estimator.field.winding_shape import Rule
from estimator.inference.convergence import Convergence, convergence
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.rig.parameters import LogNormal, Normal
from estimator.rig.rig import Rig
from estimator.units import MU0_T_M_PER_A

jax.config.update("jax_enable_x64", True)
N_CHAINS, N_WARM_UP, N_SAMPLES = 4, 300, 700
POSE = tuple(f"coil1.world_from_coil0.{key}" for key in ("x_m", "y_m", "z_m", "tilt_x_rad", "tilt_y_rad"))
NAMES = (
    "coil1.radius_m",
    "coil1.wire_radius_m",
    "coil1.axial_loops",
    "coil1.radial_loops",
    *POSE,
    "hall.noise_T",
)


class Nuts:
    """NUTS on the paper's rig: one coil that is displaced without turning, one sensor at the origin."""

    def __init__(
        self, rig: Rig, readings: Observations, reference: LogPosterior, best: torch.Tensor, rule: Rule
    ) -> None:
        self.priors = [rig.parameters[name].prior for name in NAMES]
        self.displacement_m = jnp.asarray(readings.motion["arm1"][:, :3].numpy())
        self.current_A = jnp.asarray(readings.current_A[:, 0].numpy())
        self.measured_T = jnp.asarray(readings.field_sensor_T.numpy())
        self.rule = rule
        with torch.no_grad():
            values = reference.coordinates.values(best)
            start = np.array([values[name].item() for name in NAMES])
            expected = reference.log_likelihood(best).item()
        self.mode = from_values(start)
        if not math.isclose(float(self.log_likelihood(start)), expected, abs_tol=1e-3):
            raise RuntimeError("the likelihood in jax is not that of coilcal")
        precision = -jax.hessian(self.log_posterior)(self.mode)
        self.whiten = jnp.linalg.cholesky(jnp.linalg.inv(precision))
        begin = time.perf_counter()
        self._mcmc(1, 1).run(jax.random.PRNGKey(0), init_params=jnp.zeros((N_CHAINS, len(NAMES))))
        self.compilation_s = time.perf_counter() - begin

    def run(self, seed: int) -> tuple[int, Convergence]:
        """Total number of gradients, and the convergence of the sample."""
        mcmc = self._mcmc(N_WARM_UP, N_SAMPLES)
        start = 0.1 * jax.random.normal(jax.random.PRNGKey(seed), (N_CHAINS, len(NAMES)))
        mcmc.warmup(
            jax.random.PRNGKey(seed), init_params=start, extra_fields=("num_steps",), collect_warmup=True
        )
        n_gradients = int(mcmc.get_extra_fields()["num_steps"].sum())
        mcmc.run(jax.random.PRNGKey(seed + 1), extra_fields=("num_steps",))
        n_gradients += int(mcmc.get_extra_fields()["num_steps"].sum())
        white = mcmc.get_samples(group_by_chain=True)
        values = jax.vmap(jax.vmap(lambda w: to_values(self.mode + self.whiten @ w)))(white)
        return n_gradients, convergence(np.asarray(values).transpose(1, 0, 2))

    def _mcmc(self, n_warm_up: int, n_samples: int) -> MCMC:
        kernel = NUTS(potential_fn=lambda white: -self.log_posterior(self.mode + self.whiten @ white))
        return MCMC(
            kernel,
            num_warmup=n_warm_up,
            num_samples=n_samples,
            num_chains=N_CHAINS,
            chain_method="vectorized",
            progress_bar=False,
        )

    def log_posterior(self, vector: jax.Array) -> jax.Array:
        """Log posterior density in the coordinates of this class."""
        values = to_values(vector)
        log_prior = sum(log_density(prior, value) for prior, value in zip(self.priors, values, strict=True))
        log_jacobian = jnp.log(values[jnp.array([1, 2, 3, 9])]).sum()
        return log_prior + log_jacobian + self.log_likelihood(values)

    def log_likelihood(self, values: jax.Array) -> jax.Array:
        """Log likelihood of the reported values."""
        radius_m, wire_m, n_axial, n_radial, *pose, noise_T = values
        rotation = Rotation.from_rotvec(jnp.array([pose[3], pose[4], 0.0])).as_matrix()
        points_m = -self.displacement_m - jnp.array(pose[:3]) @ rotation
        field = winding_field(points_m, radius_m, wire_m, n_axial, n_radial, self.rule)
        predicted_T = self.current_A[:, None] * field @ rotation.T
        whitened = (self.measured_T - predicted_T) / noise_T
        return -0.5 * (whitened**2).sum() - whitened.size * (jnp.log(noise_T) + 0.5 * math.log(2.0 * math.pi))


def to_values(vector: jax.Array) -> jax.Array:
    log_thickness, log_turns, log_length = vector[1:4]
    wire_m = jnp.exp(0.5 * (log_thickness + log_length - log_turns))
    n_axial, n_radial = jnp.exp(log_length) / wire_m, jnp.exp(log_thickness) / wire_m
    outer_m = vector[0] + wire_m * n_radial
    return jnp.concatenate(
        (jnp.stack((outer_m, wire_m, n_axial, n_radial)), vector[4:9], jnp.exp(vector[9:]))
    )


def from_values(values: np.ndarray) -> jax.Array:
    outer_m, wire_m, n_axial, n_radial, *pose, noise_T = values
    logs = np.log([wire_m * n_radial, n_axial * n_radial, wire_m * n_axial])
    return jnp.array([outer_m - wire_m * n_radial, *logs, *pose, np.log(noise_T)])


def log_density(prior: object, value: jax.Array) -> jax.Array:
    """Bounds are left out: they lie far from this posterior."""
    if isinstance(prior, LogNormal):
        log_value = jnp.log(value)
        return -0.5 * ((log_value - math.log(prior.median)) / prior.relative_sd) ** 2 - log_value
    assert isinstance(prior, Normal)
    return -0.5 * ((value - prior.mean) / prior.standard_deviation) ** 2


def winding_field(
    points_m: jax.Array,
    radius_m: jax.Array,
    wire_m: jax.Array,
    n_axial: jax.Array,
    n_radial: jax.Array,
    rule: Rule,
) -> jax.Array:
    """Osinde et al., eq 9-13, by the same Gauss rule as coilcal's."""
    heights, axial_weights = gauss(n_axial, rule.axial_nodes)
    radii, radial_weights = gauss(n_radial, rule.radial_nodes)
    height_m = (2.0 * wire_m * (heights - 0.5 * n_axial))[:, None, None]
    a_m = (radius_m - wire_m * n_radial + 2.0 * wire_m * radii)[None, :, None]
    x, y, z = points_m.T
    rho2 = x**2 + y**2
    radial, axial = loop_terms(rho2, z - height_m, a_m, rule.steps)
    weight = axial_weights[:, None] * radial_weights
    radial, axial = (jnp.einsum("ar,arp->p", weight, term) for term in (radial, axial))
    return jnp.stack((x * radial, y * radial, axial), axis=-1)


def gauss(count: jax.Array, n: int) -> tuple[jax.Array, jax.Array]:
    k = jnp.arange(1, n)
    off = jnp.sqrt(k**2 * (count**2 - k**2) / (4.0 * (4.0 * k**2 - 1.0)))
    nodes, vectors = jnp.linalg.eigh(jnp.diag(off, 1) + jnp.diag(off, -1))
    return nodes, count * vectors[0] ** 2


def loop_terms(rho2: jax.Array, z: jax.Array, a: jax.Array, steps: int) -> tuple[jax.Array, jax.Array]:
    """K and E by the arithmetic-geometric mean; docs/explanation/field-model.md."""
    u, s = a**2 - rho2 + z**2, a**2 + rho2 + z**2
    p = jnp.sqrt(u**2 + 4.0 * rho2 * z**2)
    mean, geometric = jnp.sqrt(0.5 * (s + p)), jnp.sqrt(p)
    term = t = 2.0 * a**2 / (s + p)
    for n in range(1, steps + 1):
        mean, geometric = 0.5 * (mean + geometric), jnp.sqrt(mean * geometric)
        term = rho2 * (term / (4.0 * mean)) ** 2
        t = t + 2.0**n * term
    common = 0.25 * MU0_T_M_PER_A / (mean * p**2)
    return common * z * (4.0 * a**2 - s * t), common * (2.0 * a**2 * u + rho2 * t * (2.0 * z**2 - u))
