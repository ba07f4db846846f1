"""Coils without a winding: maps of eight coils with iron cores and of three gradient coils, judged on blocks of places held out.

With `--box` charges on a box stand for harmonics, on the whole cube. `--together` calibrates all eight boxes at once, from one in so many
places, and compares the field of each coil with that of its own calibration, once with a noise that is known and once with a
free one, which all eight then share; it tells time and memory. `--floor` fits them to all places, none held out: what is left then,
no choice of readings could avoid.

`make harmonic-coils` runs it; it needs the folder named by COILCAL_DATA. Each map is calibrated five times without a fifth of its places,
in blocks of neighbours, on the whole cube and in balls about its middle, which leave the edges of the cube out. Then all eight
are on at once: the sum of eight calibrations of one coil, one calibration of eight coils, and the sum of the maps. The gradient coils were
measured, each as the difference of two scans in a magnet of 43 mT.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from estimator import SamplerSettings, Session, System, calibrate
from estimator.calibration.result import Calibration
from estimator.model.coil_field import unwound_field
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.importers.difference_scan import read_difference_scan
from estimator.store.importers.grid_maps import PROVENANCE, read_grid_maps

CONFIG = Path(__file__).resolve().parents[2] / "configs/mfg_8coil.yaml"
LEAST_SINGULAR = 1e-12  # of the largest: below, combinations of charges are rounding
FOLDER = "mfg-8coil-ironcore-maps"
GRADIENT_CONFIG = Path(__file__).resolve().parents[2] / "configs/mri4all_harmonic.yaml"
GRADIENT_FILES = "mri4all-gradient-coils/*_{}.csv"
N_FOLDS = 5
TARGET = 3e-3  # of the rms field
N_WORST = 10  # places
Z90 = 1.645
HARMONICS = (
    "{model: harmonic, region: interior, degree: 12, reference_radius_mm: 8.66, "
    "amplitudes: {sd_T_per_A: 2e-3, falloff: 0.7}}"
)
# The rms field in the middle is about 1 mT/A. Margin and spacing: docs/how-to/coil-without-a-winding.md.
BOX = (
    "{model: equivalent_sources, half_x_mm: 5, half_y_mm: 5, half_z_mm: 5, margin_mm: 4, spacing_mm: 1.3, "
    "amplitudes: {sd_T_per_A: 1e-3}}"
)
BALL_M = 6e-3
REGIONS = {"cube": 1.0, "ball of 7 mm": 7e-3, "ball of 6 mm": BALL_M}  # farthest place from the middle


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ess", type=float, default=400.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--degree", type=int, help="highest degree of the eight coils; that of their rig file by default"
    )
    parser.add_argument("--only", choices=REGIONS, help="one region, and nothing after it")
    parser.add_argument(
        "--box", action="store_true", help="charges on a box, on the whole cube, and nothing after it"
    )
    parser.add_argument(
        "--floor",
        action="store_true",
        help="what such charges leave when fitted to all places, and nothing else",
    )
    parser.add_argument(
        "--together",
        type=int,
        metavar="N",
        help="all eight with charges on a box in one calibration, from one in N places, and nothing else",
    )
    parser.add_argument("--coils", type=int, default=8, help="how many of them are taken together")
    options = parser.parse_args()
    data = os.environ.get("COILCAL_DATA")
    if not data or not (Path(data) / FOLDER).is_dir():
        print(f"harmonic_coils: skipped, for COILCAL_DATA must name a folder that holds {FOLDER}")
        return
    torch.set_num_threads(1)
    has_box = options.box or options.floor or options.together
    rig = eight_coils(options.degree, BOX if has_box else HARMONICS)
    files = sorted((Path(data) / FOLDER).glob("vfield_*.txt"))
    maps = [read_grid_maps([path], rig) for path in files]
    settings = SamplerSettings(target_ess=options.ess)
    print(
        f"provenance: {PROVENANCE}; so these maps are not called measured. Windings and cores are not given.\n"
    )
    if options.floor:
        for coil, whole in zip(rig.coils, maps, strict=True):
            print_floor(rig, coil.name, whole, settings, options.seed)
        return
    if options.together:
        some = with_coils(rig, [coil.name for coil in rig.coils[: options.coils]])
        for noise in ("known", "free"):
            judge_together(some, maps[: options.coils], settings, options.seed, options.together, noise)
        return
    only = "cube" if options.box else options.only
    for region in [only] if only else REGIONS:
        print(
            f"{region}: error over rms field on places held out, all five fifths; coverage of 90 % intervals there"
        )
        for i, coil in enumerate(rig.coils):
            judge_one(one_coil(rig, coil.name), maps[i], i, REGIONS[region], settings, options.seed)
        print()
    if only:
        return
    judge_all(rig, maps, settings, options.seed)
    print("\ngradient coils of MRI4ALL, measured: error over rms field on places held out, all five fifths")
    for axis in "xyz":
        gradient = load_gradient(Path(data), axis)
        judge_one(gradient.rig, gradient, 0, np.inf, settings, options.seed, None)


def eight_coils(degree: int | None, model: str = HARMONICS) -> Rig:
    """The rig file of the eight coils, with another highest degree where one is given, or another model."""
    text = CONFIG.read_text()
    assert text.count(HARMONICS) == 8
    text = text.replace(HARMONICS, model)
    return rig_from_text(
        text if degree is None else text.replace(" degree: 12,", f" degree: {degree},"), str(CONFIG)
    )


def load_gradient(data: Path, axis: str) -> Session:
    """One gradient coil, as the scan with it less the scan without."""
    text = GRADIENT_CONFIG.read_text().replace("  gradient:", f"  g{axis}:")
    paths = [next(data.glob(GRADIENT_FILES.format(name))) for name in ("b0", f"g{axis}")]
    return read_difference_scan(paths, rig_from_text(text, str(GRADIENT_CONFIG)), {f"g{axis}": 1.0})


def one_coil(rig: Rig, name: str) -> Rig:
    """The rig with a single coil."""
    return with_coils(rig, [name])


def with_coils(rig: Rig, names: list[str]) -> Rig:
    """The rig with some of its coils."""
    others = tuple(f"{coil.name}." for coil in rig.coils if coil.name not in names)
    parameters = {key: p for key, p in rig.parameters.items() if not key.startswith(others)}
    return replace(rig, coils=tuple(c for c in rig.coils if c.name in names), parameters=parameters)


def within(session: Session, farthest_m: float, rig: Rig, coil: int | None) -> Session:
    """Readings no farther from the middle, of a rig with the same coils or with one of them."""
    observations = session.observations
    if coil is not None:
        observations = replace(observations, current_A=observations.current_A[:, coil : coil + 1])
    is_near = observations.motion["stage"][:, :3].norm(dim=-1) < farthest_m
    rows = replace(observations, whole=None, chosen=None).rows(is_near)
    return Session(rig, replace(rows, whole=None, chosen=None), session.source)


def folds(session: Session, seed: int) -> torch.Tensor:
    """Fold of each reading: blocks of neighbouring places, dealt in turn."""
    rng = np.random.default_rng(seed)
    block = pose_blocks(session.observations, rng)
    order = rng.permutation(np.unique(block))
    return torch.from_numpy(np.argsort(order)[np.searchsorted(np.unique(block), block)] % N_FOLDS)


def without_fold(session: Session, fold: torch.Tensor, number: int) -> Session:
    return replace(session, observations=session.observations.with_validation(fold == number))


def judge_one(
    rig: Rig,
    whole: Session,
    coil: int,
    farthest_m: float,
    settings: SamplerSettings,
    seed: int,
    target: float | None = TARGET,
) -> None:
    """One coil's row: held-out error of all folds together, coverage, and the evidence for more degrees."""
    session = within(whole, farthest_m, rig, coil)
    fold = folds(session, seed)
    begin_s, squares, n_held, gains = time.perf_counter(), 0.0, 0.0, []
    worst_T, by_place = 0.0, []
    for number in range(N_FOLDS):
        calibration = calibrate(without_fold(session, fold, number), rig, seed=seed, settings=settings)
        result = calibration.summary()
        by_place.append(squared_errors(calibration, session, fold == number))
        n = int((fold == number).sum())
        squares += n * result["rmse"]["validation"]["vector_T"] ** 2
        worst_T = max(worst_T, result["rmse"]["validation"]["max_T"])
        n_held += n * result["coverage90"]["validation"]
        gains.append(result["next_degree_log_evidence"])
    n = len(session.observations)
    rms_T = float(session.observations.field_sensor_T.square().sum(-1).mean().sqrt())
    of_field = (squares / n) ** 0.5 / rms_T
    but_worst = share(torch.cat(by_place).sort().values[:-N_WORST], rms_T)
    asked = "" if None in gains else f"evidence for a degree more {np.median(gains):+.0f}, "
    judged = "" if target is None else f"({'below' if of_field < target else 'NOT below'} {target:.1%}), "
    print(
        f"  {rig.coils[0].name}: {n:5} places, rms field {rms_T * 1e3:.3f} mT/A, error {of_field:8.4%} {judged}"
        f"largest {worst_T / rms_T:7.3%}, without the worst {N_WORST} places {but_worst:.4%}, coverage {n_held / n:.1%}, "
        f"{asked}{(time.perf_counter() - begin_s) / N_FOLDS:.1f} s each",
        flush=True,
    )


def squared_errors(calibration: Calibration, session: Session, is_held: torch.Tensor) -> torch.Tensor:
    """Of the field of one ampere, place by place."""
    name = calibration.rig.coils[0].name
    points_m = session.observations.motion["stage"][is_held, :3]
    field_T = calibration.field(points_m, {name: 1.0})
    return (field_T - session.observations.field_sensor_T[is_held]).square().sum(-1)


def print_floor(rig: Rig, name: str, whole: Session, settings: SamplerSettings, seed: int) -> None:
    """What the charges of a coil leave when fitted to all places: by least squares with amplitudes of any size, and with their prior."""
    own = one_coil(rig, name)
    coil = own.unwound[0]
    names = [n for of_degree in coil.amplitudes.values() for n in of_degree]
    each = dict(zip(names, torch.eye(len(names), dtype=torch.float64), strict=True))
    session = within(whole, np.inf, own, [c.name for c in rig.coils].index(name))
    points_m = session.observations.motion["stage"][:, :3]
    measured_T = session.observations.field_sensor_T
    design = unwound_field(coil, each).by(None)(points_m).flatten(1).T
    column_T = measured_T.reshape(-1, 1)
    amplitudes = torch.linalg.lstsq(design, column_T, rcond=LEAST_SINGULAR, driver="gelsd").solution
    prior = own.parameters[names[0]].prior
    assert prior is not None
    any_size = (measured_T - (design @ amplitudes).reshape(-1, 3)).square().sum(-1)
    calibration = calibrate(session, own, seed=seed, settings=settings)
    squares = squared_errors(calibration, session, torch.ones(len(points_m), dtype=torch.bool))
    x_mm, y_mm, z_mm = (1e3 * points_m[squares.argmax()]).tolist()
    rms_T = rms(measured_T)
    print(
        f"  {name}: {len(names)} charges fitted to all {len(points_m)} places leave {share(squares, rms_T):.4%} with their prior, largest "
        f"{float(squares.max().sqrt()) / rms_T:.2%} at ({x_mm:.0f}, {y_mm:.0f}, {z_mm:.0f}) mm, without the worst {N_WORST} places "
        f"{share(squares.sort().values[:-N_WORST], rms_T):.4%}; {share(any_size, rms_T):.4%} by least squares, with amplitudes of "
        f"{float(amplitudes.square().mean().sqrt()) / prior.sd:.1g} times the prior",
        flush=True,
    )


def share(squares: torch.Tensor, rms_T: float) -> float:
    """Rms over that of the field."""
    return float(squares.mean().sqrt()) / rms_T


def judge_all(rig: Rig, maps: list[Session], settings: SamplerSettings, seed: int) -> None:
    """All coils on: eight calibrations, one calibration, and the sum of the maps, at places that none has seen."""
    singles = [
        within(whole, BALL_M, one_coil(rig, c.name), i)
        for i, (c, whole) in enumerate(zip(rig.coils, maps, strict=True))
    ]
    fold = folds(singles[0], seed)
    calibrations = [calibrate(without_fold(s, fold, 0), s.rig, seed=seed, settings=settings) for s in singles]
    system = System.of(*calibrations)
    together = joined(rig, singles)
    begin_s = time.perf_counter()
    one = calibrate(without_fold(together, fold.repeat(len(singles)), 0), rig, seed=seed, settings=settings)
    seconds = time.perf_counter() - begin_s
    held = fold == 0
    points_m = singles[0].observations.motion["stage"][held, :3]
    each_T = torch.stack([s.observations.field_sensor_T[held] for s in singles])
    print(
        f"all eight on, {int(held.sum())} places held out in the ball of 6 mm; the maps hold no reading with more than one coil on"
    )
    signs = torch.from_numpy(np.random.default_rng(seed).choice([-1.0, 1.0], (4, len(singles))))
    for current_A in (torch.ones(1, len(singles), dtype=torch.float64), signs):
        wanted_T = torch.einsum("sc,cpi->spi", current_A, each_T)
        summed_T = system.at(points_m).field_T(current_A)
        names = [coil.name for coil in rig.coils]
        one_T = torch.stack(
            [one.field(points_m, dict(zip(names, row.tolist(), strict=True))) for row in current_A]
        )
        rms_T = rms(wanted_T)
        label = "1 A in each" if len(current_A) == 1 else "1 A of either sign, four draws"
        print(
            f"  {label}: eight calibrations {rms(summed_T - wanted_T) / rms_T:.4%}, one calibration of eight "
            f"{rms(one_T - wanted_T) / rms_T:.4%}, between the two {rms(one_T - summed_T) / rms_T:.4%} of the rms, {rms_T * 1e3:.3f} mT"
        )
    lower, upper = system.at(points_m).field_interval_T(torch.ones(len(singles), dtype=torch.float64))
    wanted_T = each_T.sum(0)
    share = float(((lower <= wanted_T) & (wanted_T <= upper)).double().mean())
    print(f"  90 % intervals of the field, without noise, hold {share:.1%} of the sum of the maps")
    print(
        f"  one calibration of {len(rig.free)} parameters from {len(together.observations)} readings: {seconds:.0f} s"
    )
    print_amplitudes(one)


def judge_together(
    rig: Rig, maps: list[Session], settings: SamplerSettings, seed: int, one_in: int, noise: str
) -> None:
    """All coils in one calibration, beside one calibration of each, from one in so many places, in slanted planes."""
    if noise == "known":
        rig = rig.with_fixed(["probe.noise_T"])
    points_m = maps[0].observations.motion["stage"][:, :3]
    is_used = (1e3 * (points_m - points_m.amin(0))).round().sum(-1) % one_in == 0
    parts = []
    for i, (coil, whole) in enumerate(zip(rig.coils, maps, strict=True)):
        single = within(whole, np.inf, one_coil(rig, coil.name), i)
        parts.append(
            replace(single, observations=replace(single.observations.rows(is_used), whole=None, chosen=None))
        )
    begin_s = time.process_time()
    singles = [calibrate(part, part.rig, seed=seed, settings=settings) for part in parts]
    apart_s, apart_GiB = time.process_time() - begin_s, peak_GiB()
    together = joined(rig, parts)
    begin_s = time.process_time()
    one = calibrate(together, rig, seed=seed, settings=settings)
    one_s = time.process_time() - begin_s
    print(
        f"noise {noise}: {len(together.observations)} readings, {len(rig.free)} free numbers in one calibration: {one_s:.0f} s of a "
        f"processor, at most {peak_GiB():.1f} GiB; {len(singles)} by themselves {apart_s:.0f} s, {apart_GiB:.1f} GiB",
        flush=True,
    )
    for coil, alone in zip(rig.coils, singles, strict=True):
        current_A = {coil.name: 1.0}
        (lower, upper), (lower_one, upper_one) = (c.field_interval(points_m, current_A) for c in (alone, one))
        off = (one.field(points_m, current_A) - alone.field(points_m, current_A)) / (
            0.5 * (upper - lower) / Z90
        )
        ratio = (upper_one - lower_one) / (upper - lower)
        print(
            f"  {coil.name}: off by {rms(off) / 3**0.5:.1e} standard deviations rms, {float(off.abs().max()):.1e} at most, intervals "
            f"{float(ratio.median()):.3f} times as wide; noise {noise_nT(alone):.3g} and {noise_nT(one):.3g} nT",
            flush=True,
        )


def noise_nT(calibration: Calibration) -> float:
    return 1e9 * calibration.best["probe.noise_T"]


def peak_GiB() -> float:
    """Most memory that this process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def joined(rig: Rig, singles: list[Session]) -> Session:
    """The readings of all coils as one session."""
    parts = [s.observations for s in singles]
    n = [len(part) for part in parts]
    on = torch.arange(len(parts)).repeat_interleave(torch.tensor(n))
    first = parts[0]
    observations = replace(
        first,
        time_s=torch.arange(sum(n), dtype=torch.float64),
        sensor=torch.cat([part.sensor for part in parts]),
        current_A=torch.nn.functional.one_hot(on, len(parts)).double(),
        motion={"stage": torch.cat([part.motion["stage"] for part in parts])},
        field_sensor_T=torch.cat([part.field_sensor_T for part in parts]),
        is_validation=torch.cat([part.is_validation for part in parts]),
        repeat=torch.cat([part.repeat for part in parts]),
    )
    return Session(rig, observations, singles[0].source)


def print_amplitudes(one: Calibration) -> None:
    told = one.summary()["amplitudes"]
    words = ", ".join(f"{coil} {n['determined']} of {n['free']}" for coil, n in told.items())
    print(f"  amplitudes that readings determine better than the priors: {words}")


def rms(vectors: torch.Tensor) -> float:
    return float(vectors.square().sum(-1).mean().sqrt())


if __name__ == "__main__":
    main()
