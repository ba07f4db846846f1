"""A system in machine code: field and gradient at a few points, or at many poses, for loops that have no time for tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.export.linearised import WINDING_NUMBERS
from estimator.export.magnet import Magnet
from estimator.export.plain_model import PlainModel
from estimator.frames import Transform
from estimator.system.point_kernel import Tables, per_ampere

Motions = Float[np.ndarray, "*#point mover 6"]


@dataclass(frozen=True)
class CompiledSystem:
    """Coils and movers as numbers, made by `System.compiled`. Results are NaN at points inside a winding.

    Attributes:
        coils: Names of the coils, in the order of the currents.
        movers: Names of the movers that carry coils, in the order of the motions.
        tables: What the kernel reads.
    """

    coils: tuple[str, ...]
    movers: tuple[str, ...]
    tables: Tables

    @classmethod
    def of(cls, parts: Sequence[Calibration], coils: Sequence[str]) -> CompiledSystem:
        """The coils of some calibrations.

        Args:
            parts: Calibrations, each with the coils that it is responsible for.
            coils: Their names in the wanted order.
        Raises:
            InvalidInput: A rig has something besides windings, poses, linear supplies and a uniform field; the message names it.
        """
        model = Magnet(tuple(parts), tuple(coils)).model("machine code", only_round=True)
        return cls(tuple(coils), tuple(mover.name for mover in model.movers), _tables(model))

    def field_and_gradient(
        self,
        points_m: Float[np.ndarray, "point 3"],
        current_A: Float[np.ndarray, " coil"],
        motion: Motions | None = None,
    ) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, "point 3 3"]]:
        """Flux density in T and dB_i / dx_j in T/m, in the world frame.

        Args:
            points_m: Points in the world frame.
            current_A: Commanded current of each coil.
            motion: Six numbers of each mover, or these for each point; zeros where it is left out.
        Raises:
            InvalidInput: An array of another shape.
        """
        field, gradient = self._per_delivered_ampere(points_m, motion)
        if current_A.shape != (len(self.coils),):
            raise InvalidInput(
                f"currents must be one for each of {len(self.coils)} coils; received shape {current_A.shape}"
            )
        delivered_A = self.tables.supply @ current_A + self.tables.offset_A
        field_T = delivered_A @ field + self.tables.background_T
        return field_T, (delivered_A @ gradient.reshape(len(field), -1, 9)).reshape(-1, 3, 3)

    def actuation(
        self, points_m: Float[np.ndarray, "point 3"], motion: Motions | None = None
    ) -> Float[np.ndarray, "point 8 coil"]:
        """Field and gradient per commanded ampere of each coil: rows as in `SystemField.actuation`.

        Args:
            points_m, motion: As in `field_and_gradient`.
        """
        field, gradient = self._per_delivered_ampere(points_m, motion)
        rows = np.concatenate((field, gradient[:, :, 0], gradient[:, :, 1, 1:]), axis=-1)
        return np.swapaxes(rows, 1, 2) @ self.tables.supply

    def _per_delivered_ampere(
        self, points_m: np.ndarray, motion: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Field (point, coil, 3) and gradient (point, coil, 3, 3)."""
        n, n_coils, n_movers = len(points_m), len(self.coils), len(self.movers)
        rows = np.zeros((1, n_movers, 6)) if motion is None else motion
        rows = rows[None] if rows.ndim == 2 else rows
        if rows.shape not in ((1, n_movers, 6), (n, n_movers, 6)) or points_m.shape != (n, 3):
            raise InvalidInput(
                f"points must have shape (n, 3) and motion ({n_movers}, 6) or (n, {n_movers}, 6); "
                f"received {points_m.shape} and {rows.shape}"
            )
        field, gradient = np.empty((n, n_coils, 3)), np.empty((n, n_coils, 3, 3))
        per_ampere(points_m, rows, self.tables, field, gradient)
        return field, gradient


def _tables(model: PlainModel) -> Tables:
    nodes: list[np.ndarray] = []
    weights: list[np.ndarray] = []
    rules: list[tuple[int, int, int, int, int]] = []
    levels: list[int] = []
    places = []
    for coil in model.coils:
        places.append((coil.mover, coil.first_level, len(levels), len(coil.rule_of_level)))
        levels += [len(rules) + number for number in coil.rule_of_level]
        for rule in coil.rules:
            ends = []
            for way in (rule.axial, rule.radial):
                ends += [sum(map(len, nodes)), len(way.nodes)]
                nodes.append(way.nodes.numpy())
                weights.append(way.weights.numpy())
            rules.append((ends[0], ends[1], ends[2], ends[3], rule.steps))
    tables = [(mover.joints is not None, mover.joints) for mover in model.movers]
    joints = [
        (t.theta_rad, t.a_m, t.d_m, t.alpha_rad) if t is not None else np.zeros((4, 6)) for _, t in tables
    ]
    return Tables(
        np.array([[float(getattr(coil.winding, key)) for key in WINDING_NUMBERS] for coil in model.coils]),
        np.array([[_rows(coil.world_from_base), _rows(coil.flange_from_coil)] for coil in model.coils]),
        np.array(places, dtype=np.int64),
        np.array(levels, dtype=np.int64),
        np.array(rules, dtype=np.int64),
        np.concatenate(nodes),
        np.concatenate(weights),
        np.array([is_arm for is_arm, _ in tables], dtype=np.int64),
        np.array(joints, dtype=np.float64).reshape(-1, 4, 6),
        model.delivered_A_per_A.numpy(),
        model.offset_A.numpy(),
        model.background_T.numpy(),
    )


def _rows(pose: Transform) -> np.ndarray:
    return np.concatenate((pose.rotation.numpy(), pose.translation_m.numpy()[:, None]), axis=1)
