"""Gauss rules of the discrete uniform measure: replace N equal, evenly spaced loops by a few weighted ones.

The nodes are the zeros of the discrete Chebyshev (Gram) polynomials. The rule is exact for polynomials of degree 2 n - 1 and is the
full sum for n = N. Its Jacobi matrix is analytic in N, so a loop count may be any real number and carries a derivative
(docs/explanation/field-model.md, The winding).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimator.tensors import Tensor, torch

LARGEST_COUNT = 1e9  # an optimiser may step far off; squares of larger counts overflow


class DiscreteRule(NamedTuple):
    """Nodes in units of the spacing, centred on 0, and weights that add up to the count."""

    nodes: Float[Tensor, "*batch node"]
    weights: Float[Tensor, "*batch node"]


def discrete_gauss(count: Float[Tensor, "*batch"], n_nodes: int) -> DiscreteRule:
    """Gauss rule with `n_nodes` nodes for `count` unit masses at unit spacing, centred on 0.

    Args:
        count: Number of masses N, real-valued, at least n_nodes (surplus nodes are decoupled, not refused).
        n_nodes: Number of nodes; with n_nodes = N the rule is the full sum.
    Returns: Nodes in ascending order and weights, differentiable in `count`.
    References: Gautschi, Orthogonal Polynomials (2004), table 1.2, discrete Chebyshev:
        b_k = k^2 (N^2 - k^2) / (4 (4 k^2 - 1)); Golub and Welsch, Math. Comp. 23, 221 (1969).
    Examples:
        >>> rule = discrete_gauss(torch.tensor(3.0, dtype=torch.float64), 3)
        >>> [round(node, 12) for node in rule.nodes.tolist()], [round(w, 12) for w in rule.weights.tolist()]
        ([-1.0, 0.0, 1.0], [1.0, 1.0, 1.0])
    """
    if n_nodes == 1:
        return DiscreteRule(torch.zeros_like(count)[..., None], count[..., None])
    batch = count.shape
    # What was only expanded along an axis has one rule for all: eigenvalues of each draw's matrix would cost more than its field.
    count = count[tuple(slice(None) if step else slice(1) for step in count.stride())]
    count = count.clamp(max=LARGEST_COUNT)
    k = torch.arange(1, n_nodes, dtype=count.dtype, device=count.device)
    square = k**2 * (count[..., None] ** 2 - k**2) / (4.0 * (4.0 * k**2 - 1.0))
    off_diagonal = torch.sqrt(square.clamp(min=1e-12))  # a count below n_nodes decouples the surplus nodes
    jacobi = torch.diag_embed(off_diagonal, offset=1) + torch.diag_embed(off_diagonal, offset=-1)
    nodes, vectors = torch.linalg.eigh(jacobi)
    weights = count[..., None] * vectors[..., 0, :] ** 2
    return DiscreteRule(nodes.expand(*batch, n_nodes), weights.expand(*batch, n_nodes))


def arcs_of(n: int) -> Float[np.ndarray, "node 5"]:
    """Points of the four arcs of a loop with round corners, by the rule of Gauss and Legendre, in the order of the current.

    Args:
        n: Points along each arc; 0 where corners are sharp.
    Returns: Cosine, sine and weight of each point, then the signs of x and y of the middle of its arc. The first arc has the first rows.
    Examples: The weights of an arc sum to its angle.
        >>> round(float(arcs_of(4)[:4, 2].sum()), 4)
        1.5708
    """
    nodes, weights = np.polynomial.legendre.leggauss(max(n, 1))
    angle, share = 0.25 * math.pi * (nodes + 1.0), 0.25 * math.pi * weights
    cos, sin = np.cos(angle), np.sin(angle)
    turned = ((cos, sin, 1.0, 1.0), (-sin, cos, -1.0, 1.0), (-cos, -sin, -1.0, -1.0), (sin, -cos, 1.0, -1.0))
    arcs = [np.stack(np.broadcast_arrays(c, s, share, right, back), axis=-1) for c, s, right, back in turned]
    return np.concatenate([arc[:n] for arc in arcs])
