"""The visible size of a flaw: what of it is left, in sigmas, after the base model has adjusted everything it may.

Effect on each component of the calibration readings, divided by its noise; less its least-squares projection on the derivatives of
the base model by the numbers a fit is free in: R_c, R_w, N_a, N_r and the five of the coil's pose, or those of another rig file. The norm
of the rest is the visible size: the square root of the likelihood ratio (chi-squared) between model with and without the flaw, for a
linear flaw. Where a rig file states numbers tightly, leaving their priors counts as misfit.

A count need not be whole here. One loop more at the same pitch multiplies turns and length (or thickness) by 1 + 1/N, so the derivative
by a count is taken with the true number of loops, a pitch and the strength of all loops stretched by that factor. Both windings have the
same turns, length and mean radius; they differ in the variance of the loops' places by parts of 1/N^3, which no reading shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.flaw import Cause, Flaw, Record, record
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene

STEP = 1e-3  # of a prior's width
WINDING = ("radius_m", "wire_radius_m", "axial_loops", "radial_loops")
Measure = Callable[[Array], float]  # of a whitened effect that the base model has been cleared from

# What the rig file lets a fit adjust, with the standard deviation of its prior.
PRIOR_SD = {
    "radius_m": 3e-3,
    "wire_radius_m": 0.03e-3,
    "axial_loops": 3.0,
    "radial_loops": 3.0,
    "x_m": 3e-3,
    "y_m": 3e-3,
    "z_m": 3e-3,
    "tilt_x_rad": np.deg2rad(2.0),
    "tilt_y_rad": np.deg2rad(2.0),
}


def effect_T(scene: Scene, flaws: Sequence[Flaw]) -> Array:
    """What flaws change: recorded perfect readings less those that the base model expects at the recorded commands."""
    return unexpected_T(scene, record(scene, flaws))


def unexpected_T(scene: Scene, made: Record) -> Array:
    """Recorded readings less those that the base model expects at the recorded commands."""
    expected = replace(scene, current_A=made.current_A, displacement_m=made.displacement_m).measured()
    return made.field_T - expected.readings_T


@dataclass(frozen=True)
class Adjustable:
    """What the base model can imitate in a session, in whitened components of the calibration readings.

    Attributes:
        slopes: Component by number of `PRIOR_SD`, per standard deviation of its prior.
        basis: Orthonormal, of the space of the slopes.
        has_priors: Below the components stands one line for each number, its distance from its prior in standard deviations.
        prior_sd: Of each number.
    """

    scene: Scene
    slopes: Array
    basis: Array
    has_priors: bool = False
    prior_sd: Mapping[str, float] = field(default_factory=lambda: PRIOR_SD)

    @classmethod
    def of(
        cls, scene: Scene, prior_sd: Mapping[str, float] = PRIOR_SD, *, has_priors: bool = False
    ) -> Adjustable:
        """Central differences about the truth."""
        columns = []
        for name, sd in prior_sd.items():
            up, down = (_adjusted(scene, name, s * STEP * sd).measured().readings_T for s in (1.0, -1.0))
            columns.append(whiten(scene, (up - down) / (2.0 * STEP)))
        slopes = np.stack(columns, axis=1)
        return cls(
            scene, slopes, np.linalg.qr(_padded(slopes) if has_priors else slopes).Q, has_priors, prior_sd
        )

    def left_over(self, flaws: Sequence[Flaw]) -> Array:
        """Whitened effect of flaws less what the base model imitates.

        Discrete flaws are so large that a linear model would make a count negative: there it pays for leaving its priors.
        """
        effect = whiten(self.scene, effect_T(self.scene, flaws))
        if self.has_priors or not any(flaw.cause.is_discrete for flaw in flaws):
            return self.cleared(effect)
        return replace(self, basis=np.linalg.qr(_padded(self.slopes)).Q, has_priors=True).cleared(effect)

    def visible_sigma(self, flaws: Sequence[Flaw]) -> float:
        """Visible size of flaws together, in sigmas."""
        return float(np.linalg.norm(self.left_over(flaws)))

    def sigma_once_moved(self, flaws: Sequence[Flaw]) -> float:
        """Visible size of flaws after a second step of the fit of the base model, whose poses stand where the first one has put them.

        A base turned by 10 mrad looks large to slopes that were taken before it moved, and a fit follows it all the same.
        """
        effect = whiten(self.scene, effect_T(self.scene, flaws))
        pulled = np.linalg.lstsq(_padded(self.slopes), np.append(effect, np.zeros(len(self.prior_sd))))[0]
        moved, steps = self.scene, np.zeros(len(self.prior_sd))
        for i, (name, sd) in enumerate(self.prior_sd.items()):
            if name not in WINDING:
                steps[i] = pulled[i]
                moved = _adjusted(moved, name, steps[i] * sd)
        followed = whiten(self.scene, moved.measured().readings_T - self.scene.measured().readings_T)
        left = np.append(effect - followed, -steps)
        basis = np.linalg.qr(_padded(self.slopes)).Q
        return float(np.linalg.norm(left - basis @ (basis.T @ left)))

    def cleared(self, whitened: Array) -> Array:
        """Whitened effects, in columns or one, less what the base model imitates."""
        if self.has_priors:
            whitened = np.concatenate([whitened, np.zeros((self.slopes.shape[1], *whitened.shape[1:]))])
        return np.asarray(whitened - self.basis @ (self.basis.T @ whitened))


def _padded(slopes: Array) -> Array:
    return np.concatenate([slopes, np.eye(slopes.shape[1])])


def size_for(adjustable: Adjustable, cause: Cause, seed: int, target_sigma: float) -> float | None:
    """Size at which a cause has the wanted visible size; None where it has not even at its largest plausible size."""
    return crossing(adjustable, cause, seed, target_sigma, lambda left_over: float(np.linalg.norm(left_over)))


def crossing(
    adjustable: Adjustable, cause: Cause, seed: int, target: float, measure: Measure
) -> float | None:
    """Size at which a measure of what is left over meets the target: steps in proportion, kept between the last below and the last above."""
    low, high = 0.0, cause.largest
    size = high
    found = measure(adjustable.left_over([Flaw(cause, size, seed)]))
    if found < target:
        return None
    for _ in range(40):
        if abs(found - target) <= 1e-3 * target:
            break
        low, high = (size, high) if found < target else (low, size)
        guess = size * target / found if found > 0.0 else high
        size = guess if low < guess < high else 0.5 * (low + high)
        found = measure(adjustable.left_over([Flaw(cause, size, seed)]))
    return size


def whiten(scene: Scene, readings_T: Array) -> Array:
    """Components of the calibration readings over their noise, in one column."""
    used = ~scene.schedule.is_validation
    return np.asarray((readings_T / scene.sigma_T)[used].ravel())


def _adjusted(scene: Scene, name: str, step: float) -> Scene:
    """The ideal scene with one number of the base model moved."""
    winding = scene.winding
    if name == "radius_m":
        return _rewound(scene, replace(winding, radius_m=winding.radius_m + step))
    if name == "wire_radius_m":
        return _rewound(scene, replace(winding, wire_radius_m=winding.wire_radius_m + step))
    if name == "axial_loops":
        stretch = 1.0 + step / winding.axial_loops
        return _rewound(scene, replace(winding, turn_factor=stretch, axial_pitch_factor=stretch))
    if name == "radial_loops":
        stretch = 1.0 + step / winding.radial_loops
        return _rewound(scene, replace(winding, turn_factor=stretch, radial_pitch_factor=stretch))
    if name.startswith(("base_", "mount_")):
        return _rearranged(scene, name, step)
    if name.startswith("tilt"):
        turn = Rotation.from_rotvec(step * np.eye(3)["xyz".index(name[5])]).as_matrix()
        return replace(scene, coil_rotation=scene.coil_rotation @ turn)
    return replace(scene, coil_position_m=scene.coil_position_m + step * np.eye(3)["xyz".index(name[0])])


def _rearranged(scene: Scene, name: str, step: float) -> Scene:
    """The ideal scene with one number of the arm's base or of the mount moved."""
    arm, (place, _, quantity) = scene.arm, name.partition("_")
    assert arm is not None
    along = step * np.eye(3)[2 if quantity == "spin_rad" else "xyz".index(quantity.split("_")[-2])]
    turn = Rotation.from_rotvec(along).as_matrix()
    if place == "mount" and quantity.endswith("_rad"):
        return replace(scene, flange_from_coil=scene.flange_from_coil @ turn)
    if place == "mount":
        return replace(scene, arm=replace(arm, mount_m=arm.mount_m + along))
    if quantity.endswith("_rad"):
        return replace(scene, arm=replace(arm, base_rotation=arm.base_rotation @ turn))
    return replace(scene, arm=replace(arm, base_position_m=arm.base_position_m + along))


def _rewound(scene: Scene, winding: Winding) -> Scene:
    return replace(scene, winding=winding, coil_field=circular_field(blocks_of(winding)))
