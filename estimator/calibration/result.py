"""A calibrated model: the field anywhere, with credible intervals, and its files on disk."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.devices import numpy_of
from estimator.effects.stages import RoomEffect
from estimator.effects.use import uses_of
from estimator.errors import CorruptStore, InvalidInput, cut, quoted
from estimator.export import formats
from estimator.export.magnet import Magnet
from estimator.export.request import Grid
from estimator.given_files import MOST_RESULT_BYTES, read_given
from estimator.glance import Glance, Shown
from estimator.json_files import json_object
from estimator.model.room_field import RoomField, some_at_a_time
from estimator.points import given_motion, given_points
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import MotionKind, Rig
from estimator.rig_files.state import rig_from_state, rig_state
from estimator.store.admission import admit, admit_readings
from estimator.store.arrays import ARRAYS, observation_arrays, observations_from
from estimator.store.files import kind_of, unwritable, write_text
from estimator.store.made import GROUP, Made, arrays_of, holds
from estimator.store.staging import staged
from estimator.store.tree import Node, read_tree, tree_hash
from estimator.units import LARGEST

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCHEMA_VERSION = 1
POSTERIOR_STORE, SUMMARY_FILE, CHAIN_STORE, REPORT = (
    "posterior.zarr",
    "summary.json",
    "chain.zarr",
    "report.html",
)
SUMMARY_SEAL = "summary_sha256"
SUMMARY_KEYS: Mapping[str, type] = {
    **dict.fromkeys(
        ("parameters", "prior_tension", "rmse", "rmse_nominal", "rmse_by_sensor", "coverage90"), dict
    ),
    **dict.fromkeys(("sampling", "point_estimate", "truth", "versions"), dict),
    **dict.fromkeys(("loop_counts", "undetermined"), list),
    **dict.fromkeys(("is_converged", "has_integer_counts"), bool),
    **dict.fromkeys(("session_source", "session_created", "session_hash", "rig_hash"), str),
    "seed": int,
}
"""What pages read of a summary; one that is older than its seal may have been altered unnoticed."""
INTERVAL_DRAWS = 400
DOUBLE = torch.empty(0, dtype=torch.float64)
Kind = TypeVar("Kind")  # of points: answers are of the same


@dataclass(frozen=True, repr=False)
class Calibration(Shown):
    """The result of a calibration.

    Attributes:
        rig: The rig with its priors.
        observations: The readings it was made from, validation included.
        best: Every number of the rig at the maximum of the posterior, with the most probable whole loop counts.
        draws: Posterior draws of every free parameter, walker by step.
        log_prob: Log posterior density of the draws, up to a constant. Draws that were widened keep the density of the draws before.
        summary_json: Content of `summary.json`.
    """

    rig: Rig
    observations: Observations
    best: Mapping[str, float]
    draws: Mapping[str, np.ndarray]
    log_prob: np.ndarray
    summary_json: Mapping[str, Any]

    def field(
        self, points_m: Kind, currents_A: Mapping[str, float], motion: Mapping[str, Any] | None = None
    ) -> Kind:
        """Flux density of the calibrated model in the world frame, in tesla.

        Args:
            points_m: Points in the world frame, x, y, z last: one or many, as a list, a NumPy array, a tensor or an `xarray.DataArray`. The
                prediction is made on the device and in the precision of a tensor.
            currents_A: Current of each coil by name; coils that are not named are off.
            motion: The six numbers of each mover's columns. A mover that reports displacements defaults to zero, its reference
                configuration; any other mover that carries a coil must be named.
        Returns: Bx, By, Bz in the kind that was given; NaN at points inside a winding.
        Raises:
            InvalidInput: An unknown coil or mover, a mover without its motion, or a number that is not finite or beyond `LARGEST`.
        Examples:
            >>> calibration.field([0.0, 0.0, 0.05], {"coil1": 2.0})  # doctest: +SKIP
            [1.2e-05, -3.0e-06, 0.00214]
        """
        given = given_points(points_m)
        room = self.room(given.points_m, motion)
        field_T = room.field_T(self.best_values(given.points_m), self.currents(currents_A, given.points_m))
        return cast(Kind, given.answer(field_T, "magnetic flux density", "T"))

    def gradient(
        self, points_m: Kind, currents_A: Mapping[str, float], motion: Mapping[str, Any] | None = None
    ) -> Kind:
        """dB_i / dx_j of the calibrated model in the world frame, in T/m, with two more axes; arguments as in `field`.

        It is symmetric and traceless, as in any source-free region.
        """
        given = given_points(points_m)
        room = self.room(given.points_m, motion)
        values, current_A = self.best_values(given.points_m), self.currents(currents_A, given.points_m)
        return cast(Kind, given.answer(room.gradient_T_per_m(values, current_A), "field gradient", "T/m"))

    def field_interval(
        self,
        points_m: Kind,
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Any] | None = None,
    ) -> tuple[Kind, Kind]:
        """Credible interval of each field component, from the uncertainty that data and priors leave in the model.

        Args:
            points_m, currents_A, motion: As in `field`.
            level: Probability inside the interval, 0 < level < 1.
        Returns: Lower and upper ends in tesla, from 400 posterior draws, evenly spaced in the order of the steps: always the same ones.
            By their number, each end is known to a tenth of the posterior's standard deviation (for a level of 0.9).
        Raises:
            InvalidInput: Level outside (0, 1), or as in `field`.
        """
        return self._interval(points_m, currents_A, level, motion, is_gradient=False)

    def gradient_interval(
        self,
        points_m: Kind,
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Any] | None = None,
    ) -> tuple[Kind, Kind]:
        """Credible interval of each dB_i / dx_j, in T/m; as `field_interval`."""
        return self._interval(points_m, currents_A, level, motion, is_gradient=True)

    def _interval(
        self,
        points: Kind,
        currents_A: Mapping[str, float],
        level: float,
        motion: Mapping[str, Any] | None,
        is_gradient: bool,
    ) -> tuple[Kind, Kind]:
        _check_level(level)
        given = given_points(points)
        points_m = given.points_m
        room, current_A = self.room(points_m, motion), self.currents(currents_A, points_m)
        predict = room.gradient_T_per_m if is_gradient else room.field_T
        draws, shape = self.draw_values(INTERVAL_DRAWS, points_m), (3, 3) if is_gradient else (3,)
        values = some_at_a_time(lambda drawn: predict(drawn, current_A), draws, len(points_m), 1 + len(shape))
        name, unit = ("field gradient", "T/m") if is_gradient else ("magnetic flux density", "T")
        ends = self.ends(values, (len(points_m), *shape), level)
        lower, upper = (
            cast(
                Kind,
                given.answer(end, f"{which} end of the {100.0 * level:g} % interval of the {name}", unit),
            )
            for which, end in zip(("lower", "upper"), ends, strict=True)
        )
        return lower, upper

    def coils_alone(self) -> Calibration:
        """This calibration without what is there without current, such as the Earth's field, whose uncertainty a coil has no part in.

        Where no sensor turned, the field of the room is known only together with the zeros of the sensors, so that intervals of both
        together are far wider than those of the coils.
        """
        background = {use.cause for use in uses_of(self.rig, RoomEffect) if use.effect.is_background}
        effects, corrections = (
            tuple(cause for cause in acting if cause not in background)
            for acting in (self.rig.effects, self.rig.corrections)
        )
        return replace(self, rig=replace(self.rig, effects=effects, corrections=corrections))

    def ends(
        self, values: Float[Tensor, "..."], shape: tuple[int, ...], level: float
    ) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."]]:
        """Ends of the central interval of a shape, over values for `draw_values(INTERVAL_DRAWS)` on the first axis."""
        n_draws = min(INTERVAL_DRAWS, self.log_prob.size)
        values = values.expand(n_draws, *shape)  # no batch where no coil is free
        tails = [0.5 - 0.5 * level, 0.5 + 0.5 * level]
        # Takes a third of the time of torch.quantile, which sorts.
        ends = np.quantile(numpy_of(values), tails, axis=0)
        lower, upper = torch.from_numpy(ends).to(values)
        return lower, upper

    def room(self, points_m: Float[Tensor, "point 3"], motion: Mapping[str, Any] | None) -> RoomField:
        """The coils with each mover in one pose, or in one pose per point, ready for any values of the rig and any currents.

        Args:
            points_m: Points in the world frame.
            motion: As in `field`, or a row of six numbers for each point.
        Raises:
            InvalidInput: As in `field`.
        """
        motion = given_motion(motion, points_m)
        carriers = {coil.carried_by for coil in self.rig.coils}
        for mover in self.rig.movers:
            if mover.name in motion:
                numbers = motion[mover.name]
                if numbers.shape[-1:] != (6,) or not bool((numbers.abs() <= LARGEST).all()):
                    received = cut(str(numbers.tolist()), 200)
                    raise InvalidInput(
                        f"motion of {mover.name} must be six numbers between {-LARGEST:g} and {LARGEST:g}; received {received}"
                    )
            elif mover.name in carriers and mover.motion is not MotionKind.DISPLACEMENT:
                raise InvalidInput(
                    f"motion of {mover.name} must be given ({', '.join(mover.columns)}): it carries a coil; received none"
                )
        if not torch.isfinite(points_m).all():
            raise InvalidInput("points must be finite; received NaN or infinity among them")
        return RoomField(self.rig, self.best_values(points_m), points_m, motion)

    def best_values(self, like: Tensor = DOUBLE) -> dict[str, Tensor]:
        """Every number of the rig at the maximum of the posterior, as `RoomField` takes them.

        Args:
            like: A tensor on the device and in the precision that are wanted; double precision on the processor by default.
        """
        return {name: like.new_tensor(value) for name, value in self.best.items()}

    def draw_values(self, most: int, like: Tensor = DOUBLE) -> dict[str, Tensor]:
        """Every number of the rig for evenly spaced draws of the posterior, in the order of the steps; `like` as in `best_values`."""
        n_draws = self.log_prob.size
        index = np.linspace(0, n_draws - 1, min(most, n_draws)).astype(int)
        chosen = {name: torch.from_numpy(array.T.reshape(-1)[index]) for name, array in self.draws.items()}
        coordinates = Coordinates(self.rig, integer_counts=True)
        return {
            name: value.to(like) for name, value in coordinates.values(coordinates.vector(chosen)).items()
        }

    def summary(self) -> Mapping[str, Any]:
        """Parameters with credible intervals, loop counts, errors, coverage and provenance: the content of `summary.json`."""
        return self.summary_json

    def glance(self) -> Glance:
        """What is shown of it: how good it is, its parameters, and what the data taught."""
        from estimator.calibration.shown import calibration_glance

        return calibration_glance(self)

    def plot_field(self, coil: str | None = None) -> Figure:
        """Field of one ampere in the plane through a coil's axis, and its uncertainty (`plots.field_plane`).

        Args:
            coil: Its name; the first where left out.
        Raises:
            InvalidInput: The rig has no such coil, or it never carried current.
        Examples:
            >>> calibration.plot_field().savefig("field.png")  # doctest: +SKIP
        """
        from estimator.calibration.shown import plot_field

        return plot_field(self, coil)

    def plot_residuals(self, ax: Axes | None = None) -> Axes:
        """Residuals of the fit over the noise beside the normal density (`plots.residual_histogram`)."""
        from estimator.calibration.shown import plot_residuals

        return plot_residuals(self, ax)

    def plot_parameters(self, ax: Axes | None = None) -> Axes:
        """Prior and posterior of every free parameter: what the data taught (`plots.interval_summary`)."""
        from estimator.calibration.shown import plot_parameters

        return plot_parameters(self, ax)

    def magnet(self) -> Magnet:
        """What exports write: the coils."""
        return Magnet.of(self)

    def export(
        self,
        to: str,
        path: Path | str | None = None,
        *,
        grid: Grid | None = None,
        currents_A: Mapping[str, float] | None = None,
        motion: Mapping[str, Float[Tensor, " 6"]] | None = None,
    ) -> Path:
        """Write the model for other programs, as `coilcal export` does (docs/how-to/use-a-calibration-elsewhere.md).

        Args:
            to: Name of a format, such as "cpp".
            path: File to write; one named after the rig, in the current folder, where none is given.
            grid, currents_A, motion: Points, currents and poses, for formats that take them.
        Returns: The file.
        Raises:
            InvalidInput: An unknown format, something it does not take or lacks, or a model that it cannot express.
        """
        return formats.export(self.magnet(), to, path, grid=grid, currents_A=currents_A, motion=motion)

    def save(self, folder: Path | str) -> None:
        """Write `posterior.zarr` (ArviZ groups for `xarray.open_datatree`), then `summary.json`, which marks the result as complete.

        Raises:
            InvalidInput: The folder cannot be written, or files of somebody else have these names in it.
        """
        folder = Path(folder)
        CALIBRATION.check_open(folder)
        summary = json.dumps(self.summary_json, indent=2, allow_nan=False) + "\n"
        try:
            with staged(folder / POSTERIOR_STORE, overwrite=True, made=POSTERIOR) as new:
                self._write_posterior(new, summary)
                (folder / SUMMARY_FILE).unlink(
                    missing_ok=True
                )  # never beside a posterior that is not its own
            write_text(folder / SUMMARY_FILE, summary)
        except OSError as error:
            raise unwritable(folder, error) from error

    @classmethod
    def load(cls, folder: Path | str) -> Calibration:
        """Read what `save` wrote.

        Raises:
            InvalidInput: The folder holds no finished calibration.
            CorruptStore: A file in it is damaged.
        """
        folder = Path(folder)
        if not (folder / SUMMARY_FILE).is_file():
            raise InvalidInput(
                f"calibration must be a folder that coilcal calibrate finished (with {SUMMARY_FILE}); received {folder}"
            )
        admit(folder / POSTERIOR_STORE, "calibration")
        try:
            text = read_given(folder / SUMMARY_FILE, MOST_RESULT_BYTES, CorruptStore)
            summary = json_object(text, folder / SUMMARY_FILE, CorruptStore)
            tree = read_tree(folder / POSTERIOR_STORE)
            attributes = tree["/"].attributes
            if attributes["schema_version"] != SCHEMA_VERSION:
                raise CorruptStore(
                    f"calibration schema_version must be {SCHEMA_VERSION}; received {quoted(attributes['schema_version'])} ({folder})"
                )
            stored_hash = attributes.pop("sha256")
            if stored_hash != tree_hash(tree):
                raise CorruptStore(
                    f"calibration must match its SHA-256; {folder / POSTERIOR_STORE} was altered or lost a chunk"
                )
            # Version 0.1 and the first of 0.2 did not seal the summary.
            if attributes.get(SUMMARY_SEAL, _sha256(text)) != _sha256(text):
                raise CorruptStore(
                    f"calibration must match its SHA-256; {folder / SUMMARY_FILE} was altered, or belongs to another posterior"
                )
            arrays = {**tree["/constant_data"].arrays, **tree["/observed_data"].arrays}
            rig = rig_from_state(json_object(attributes["rig"], folder), f"rig inside {folder}")
            admit_readings(arrays, rig, str(folder))
            observations, best = observations_from(arrays, rig), json_object(attributes["best"], folder)
            draws, log_prob = tree["/posterior"].arrays, tree["/sample_stats"].arrays["lp"]
            _check_numbers(rig, best, draws, log_prob, folder)
            if any(not isinstance(summary[key], kind) for key, kind in SUMMARY_KEYS.items()):
                raise CorruptStore(
                    f"calibration must have a summary as coilcal writes it; {folder / SUMMARY_FILE} is another"
                )
        except CorruptStore:
            raise
        except Exception as error:  # zarr, JSON and NumPy raise errors of many types on damaged bytes
            raise CorruptStore(
                f"calibration must be readable; {folder} is damaged: {type(error).__name__} {error}"
            ) from error
        return cls(rig, observations, best, draws, log_prob, summary)

    def _write_posterior(self, path: Path, summary: str) -> None:
        import xarray as xr  # almost a second, which whoever reads does without
        from zarr.codecs import Crc32cCodec, ZstdCodec

        walkers, steps = self.log_prob.shape
        coords = {"chain": np.arange(walkers), "draw": np.arange(steps)}
        attributes = {
            "schema_version": SCHEMA_VERSION,
            "rig": json.dumps(rig_state(self.rig)),
            "best": json.dumps(dict(self.best)),
            SUMMARY_SEAL: _sha256(summary.encode()),
        }
        posterior = {name: (("chain", "draw"), draws) for name, draws in self.draws.items()}
        arrays = observation_arrays(self.observations)
        tree = xr.DataTree.from_dict(
            {
                "/": xr.Dataset(attrs=attributes),
                "/posterior": xr.Dataset(posterior, coords, {"inference_library": "emcee"}),
                "/sample_stats": xr.Dataset({"lp": (("chain", "draw"), self.log_prob)}, coords),
                "/observed_data": xr.Dataset({"field_sensor_T": arrays.pop("field_sensor_T")}),
                "/constant_data": xr.Dataset(arrays),
            }
        )
        tree.attrs["sha256"] = tree_hash({node.path: _as_read(node) for node in tree.subtree})
        checksummed = {"compressors": [ZstdCodec(level=3), Crc32cCodec()]}
        encoding = {node.path: dict.fromkeys(node.dataset.variables, checksummed) for node in tree.subtree}
        tree.to_zarr(path, mode="w", zarr_format=3, consolidated=False, encoding=encoding)

    def currents(self, currents_A: Mapping[str, float], like: Tensor = DOUBLE) -> Float[Tensor, " coil"]:
        """Currents in the order of the rig's coils; those that are not named are off. `like` as in `best_values`."""
        names = [coil.name for coil in self.rig.coils]
        if not isinstance(cast(object, currents_A), Mapping):
            example = {names[0]: 2.0}
            raise InvalidInput(
                f"currents must be given by coil, such as {example}; received {quoted(currents_A)}"
            )
        for name in currents_A:
            if name not in names:
                raise InvalidInput(
                    f"currents must name coils of the rig ({', '.join(names)}); received {quoted(name)}"
                )
            if not abs(currents_A[name]) <= LARGEST:
                rule = f"current of {name} must lie between {-LARGEST:g} and {LARGEST:g}"
                raise InvalidInput(f"{rule}; received {currents_A[name]:g}")
        return like.new_tensor([float(currents_A.get(name, 0.0)) for name in names])


# By what damage may leave of them, too.
POSTERIOR_FILES = (
    rf"zarr\.json|(?:posterior|sample_stats)/(?:{arrays_of('[^/]+')})"
    rf"|(?:observed_data|constant_data)/(?:{arrays_of(ARRAYS)})"
)
CHAIN_FILES = arrays_of("chain|log_prob|checkpoint|accepted")
POSTERIOR = Made(
    "a posterior",
    POSTERIOR_FILES,
    (GROUP,),
    lambda folder: holds(folder / GROUP, '"best"') or (folder / "sample_stats" / GROUP).is_file(),
)
CHAIN = Made(
    "a chain of samples",
    CHAIN_FILES,
    (GROUP,),
    lambda folder: holds(folder / GROUP, '"array_crc32"') or (folder / "log_prob" / GROUP).is_file(),
)
CALIBRATION = Made(
    "a calibration",
    rf"summary\.json|report\.html|posterior\.zarr/(?:{POSTERIOR_FILES})|chain\.zarr/(?:{CHAIN_FILES})",
    (SUMMARY_FILE, POSTERIOR_STORE, CHAIN_STORE, REPORT),
    lambda folder: (
        holds(folder / SUMMARY_FILE, '"coverage90"')
        or POSTERIOR.is_one(folder / POSTERIOR_STORE)
        or CHAIN.is_one(folder / CHAIN_STORE)
    ),
)


def remove_calibration(folder: Path) -> None:
    """Delete the files of an earlier calibration from a folder, and nothing else.

    Raises:
        InvalidInput: One of them holds something that coilcal did not write; nothing is deleted then.
    """
    check_calibration(folder)
    for name in CALIBRATION.names:
        path = folder / name
        if kind_of(path) == "a folder":
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def check_calibration(folder: Path) -> None:
    """Refuse a folder in which files of somebody else have the names of a calibration.

    Raises:
        InvalidInput: It holds such files.
    """
    CALIBRATION.check_open(folder)
    for name, store in ((POSTERIOR_STORE, POSTERIOR), (CHAIN_STORE, CHAIN)):
        if kind_of(folder / name) is not None:
            store.check_replaceable(folder / name)
    for name in (SUMMARY_FILE, REPORT):
        if kind_of(folder / name) not in (None, "a file"):
            raise InvalidInput(f"output must be a file; {folder / name} is {kind_of(folder / name)}")


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise InvalidInput(f"level must lie between 0 and 1; received {level}")


def _check_numbers(
    rig: Rig, best: Mapping[str, float], draws: Mapping[str, np.ndarray], log_prob: np.ndarray, folder: Path
) -> None:
    """Refuse a posterior that lacks a number of the rig, or holds another shape or no finite number."""
    for name in rig.parameters:
        if not math.isfinite(best[name]):
            raise CorruptStore(f"best {name} must be finite; received {best[name]} ({folder})")
    for parameter in rig.free:
        values = draws[parameter.name]
        if values.shape != log_prob.shape or not np.isfinite(values).all():
            raise CorruptStore(
                f"draws of {parameter.name} must be finite and of shape {log_prob.shape}; "
                f"received {'others' if values.shape == log_prob.shape else values.shape} ({folder})"
            )


def _sha256(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()


def _as_read(node: xr.DataTree) -> Node:
    """A node of a tree as `read_tree` will find it."""
    variables = {
        str(name): (tuple(map(str, variable.dims)), variable.to_numpy())
        for name, variable in node.dataset.variables.items()
    }
    return Node({str(name): value for name, value in node.attrs.items()}, variables)
