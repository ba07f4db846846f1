"""What each cause does to sessions of fixed seeds, and what the first session of each kind is.

Studies are compared from one year to the next, so a seed means the same session for good. `python -m tests.hidden.frozen` adds the numbers
of new causes and kinds to `frozen.json` and leaves those that are there; `test_frozen` computes all of them again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.hidden.flaw import Cause, Flaw, Record, record
from tests.hidden.library import ALL, FIRST, OUTSIDE
from tests.hidden.open_session import draw_open_scene
from tests.hidden.protocols import MOTIONS, PROTOCOLS, Array
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import StatedRig
from tests.hidden.study import KINDS, MIXED_KINDS, OPEN_KINDS, draw_case

Frozen = tuple[list[float], list[str]]  # numbers, and words that say what is true
Sessions = dict[tuple[str, str], tuple[StatedRig, Scene]]
FILE = Path(__file__).with_name("frozen.json")
SHAPES = (3, 4, 5)  # seeds of all about a flaw but its size
EVERY_KIND = (*KINDS, *OPEN_KINDS, *MIXED_KINDS)
LIBRARY = set(FIRST) - set(OUTSIDE)


def draw_sessions() -> Sessions:
    """One of each motion and protocol."""
    drawn: Sessions = {}
    rng = np.random.default_rng(17)
    while len(drawn) < len(MOTIONS) * len(PROTOCOLS):
        rig, scene = draw_open_scene(rng)
        drawn.setdefault((rig.motion, scene.schedule.protocol), (rig, scene))
    return drawn


def fingerprint(*arrays: Array) -> list[float]:
    """Norm of each array, and its sum with weights that change from number to number."""
    flat = [np.ravel(array).astype(np.float64) for array in arrays]
    return [float(v) for x in flat for v in (np.linalg.norm(x), x @ np.cos(1.7 * np.arange(len(x))))]


def of_cause(cause: Cause, sessions: Sessions) -> Frozen:
    """Fingerprints of what a flaw changes, and its true numbers, by session and shape."""
    numbers: list[float] = []
    words: dict[str, None] = {}
    for scene in scenes_of(cause, sessions):
        noise = np.random.default_rng(7).normal(size=(len(scene.schedule), 3))
        plain = record(scene, [], noise)
        for shape in SHAPES:
            flaw = Flaw(cause, 1.0 if cause.is_discrete else 0.4 * cause.largest, shape)
            made = record(scene, [flaw], noise)
            pairs = [
                (getattr(made, n), getattr(plain, n)) for n in ("field_T", "current_A", "displacement_m")
            ]
            numbers += fingerprint(*(flawed - right for flawed, right in pairs))
            named = _named(made)
            numbers += named.values()
            words |= dict.fromkeys(named)
    return numbers, list(words)


def _named(made: Record) -> dict[str, float]:
    """True numbers by place, name and unit."""
    return {f"{t.place} {k.name} {k.unit}": k.value for t in made.truths for k in t.parameters}


def scenes_of(cause: Cause, sessions: Sessions) -> Iterator[Scene]:
    """The sessions of the motions that differ most, where the cause can happen."""
    for motion, protocol in (("displacement", "recommended"), ("pose", "paper"), ("UR3e", "paper")):
        if motion in cause.motions and protocol in cause.protocols:
            yield sessions[motion, protocol][1]


def of_kind(kind: str) -> Frozen:
    """Fingerprints of a session of a study, and all that is true about it."""
    hidden = draw_case(kind, 3, LIBRARY)
    made, schedule = hidden.record, hidden.schedule
    arrays = (made.field_T, made.current_A, made.displacement_m, schedule.time_s, schedule.is_validation)
    named = _named(made)
    causes = [flaw.cause.name for flaw in hidden.flaws]
    return [*fingerprint(*arrays), *(flaw.size for flaw in hidden.flaws), *named.values()], [*causes, *named]


def main() -> None:
    """Write the numbers of what has none."""
    known = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    sessions = draw_sessions()
    for name, cause in ALL.items():
        if name not in known:
            known[name] = of_cause(cause, sessions)
    for kind in EVERY_KIND:
        if f"kind {kind}" not in known:
            known[f"kind {kind}"] = of_kind(kind)
    rows = [
        f"{json.dumps(name)}: {json.dumps([[float(f'{v:.9g}') for v in numbers], words])}"
        for name, (numbers, words) in known.items()
    ]
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
