"""A declaration and a function make an effect, and what is wrong with them is said in one sentence; what lasts for a part of a session."""

from __future__ import annotations

import inspect

import pytest
import torch

from estimator.effects import EFFECTS
from estimator.effects.base import POSITIVE, normal, switch
from estimator.effects.circumstances import SINCE, UNTIL, Circumstances, Extent
from estimator.effects.during import During, during, spell
from estimator.effects.stages import CurrentEffect, MotionEffect, ReadingEffect, RecordEffect, RoomEffect
from estimator.errors import InvalidInput
from estimator.frames import Transform, rotation_from_vector
from estimator.readings.observations import Observations
from estimator.rig_files.read import rig_from_text

RIG = """
schema_version: 1
name: small
movers: {mapper: {motion: pose}}
coils: {coil: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4}}
sensors: {hall: {carried_by: mapper, noise_uT: 5}}
"""
N = 12
BENT = {"words": "it bends", "source": "data sheets", "quantities": (normal("excess", "1", 0.1),)}


def bent(field_sensor_T, theta):
    """The sensor bends.

    With its field.
    """
    return field_sensor_T * (1.0 + theta["excess"][..., None, None])


@pytest.fixture(scope="module")
def circumstances() -> Circumstances:
    motion = torch.rand(N, 6, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    field_T, time_s = torch.full((N, 3), 1e-3).double(), 900.0 * torch.arange(N, dtype=torch.float64)
    observations = Observations.of(torch.ones(N, 1).double(), {"mapper": motion}, field_T, time_s=time_s)
    return Circumstances(rig_from_text(RIG), observations)


def test_function_gives_name_and_explanation_and_takes_what_it_needs(circumstances):
    effect = ReadingEffect.cause(**BENT, is_linear=False, starts=({"excess": 1.0},))(bent)
    assert (effect.name, effect.words, effect.is_linear) == ("bent", "it bends", False)
    assert inspect.getdoc(type(effect)) == "The sensor bends.\n\nWith its field."
    assert effect.quantities(Extent()) == BENT["quantities"]
    assert effect.starts(circumstances, "hall") == ({"excess": 1.0},)
    read_T = effect.apply(torch.ones(N, 3), {"excess": torch.tensor(0.5)}, circumstances, "hall")
    assert read_T.tolist() == [[1.5] * 3] * N


def silent(field_sensor_T):
    return field_sensor_T


def test_docstring_says_words_and_source_and_explains():
    @ReadingEffect.cause(quantities=BENT["quantities"])
    def worn(field_sensor_T):
        """The sensor is worn.

        Its surface is rough.

        Rougher each day.

        Source: data sheets,
        and experience.
        """
        return field_sensor_T

    assert (worn.words, worn.source) == ("the sensor is worn", "data sheets, and experience")
    assert inspect.getdoc(type(worn)) == "Its surface is rough.\n\nRougher each day."

    @during(worn)
    def worn_since():
        """From one instant on the sensor is worn."""

    assert (worn_since.words, worn_since.source) == ("from one instant on the sensor is worn", worn.source)
    assert inspect.getdoc(type(worn_since)) == "From one instant on the sensor is worn."


@pytest.mark.parametrize(
    ("declare", "sentence"),
    [
        (
            lambda: ReadingEffect.cause(**BENT, is_structral=True)(bent),
            "bent must declare attributes of ReadingEffect; received is_structral; the closest is is_structural",
        ),
        (
            lambda: ReadingEffect.cause(quantities=())(silent),
            "silent must have a docstring with words in its first line and a last paragraph 'Source: ...'; received ''",
        ),
        (
            lambda: ReadingEffect.cause(quantities=())(bent),
            "bent must have a docstring with words .* received 'With its field.'",
        ),
        (
            lambda: ReadingEffect.cause(**BENT)(lambda tau: tau),
            "must take some of field_sensor_T, theta, circumstances, sensor; received tau",
        ),
        (
            lambda: ReadingEffect.cause(**BENT, starts=lambda rig: rig)(bent),
            "starts of bent must take some of circumstances, place; received rig",
        ),
        (
            lambda: during(EFFECTS["iron_body"], words="iron that comes"),
            "iron_body must be of a current, a reading, a steady field, a mover or rows to be there",
        ),
        (
            lambda: RecordEffect.cause(**BENT)(bent),
            "bent must say which method of RecordEffect it is; received no name, and open are none",
        ),
    ],
)
def test_what_is_wrong_with_a_declaration_is_said(declare, sentence):
    with pytest.raises(InvalidInput, match=sentence):
        declare()


def test_first_number_that_breaks_its_rule_is_named():
    numbers = (switch("a", 0.0, 9.0, 1.0, POSITIVE), switch("b", 0.0, 1.0, 1.0))
    effect = ReadingEffect.cause(**BENT | {"quantities": numbers})(bent)
    assert effect.broken_rule({"a": -1.0, "b": 1.0}) == ("a", "must be > 0")
    assert effect.broken_rule({"a": 1.0, "b": 5.0}) is None


def of_stage(stage, *names, **others):
    """An effect of a stage that adds a number."""
    quantities = (normal("size", "1", 1.0),)

    return stage.cause(*names, words="more", source="nowhere", quantities=quantities, **others)


@of_stage(ReadingEffect)
def more_shown(field_sensor_T, theta):
    """More is shown."""
    return field_sensor_T + theta["size"][..., None, None]


@of_stage(CurrentEffect)
def more_current(current_A, theta):
    """More flows."""
    return current_A + theta["size"][..., None, None]


@of_stage(RoomEffect, "steady_T")
def more_field(points_m, theta):
    """More field."""
    return torch.ones_like(points_m) * theta["size"][..., None, None]


@of_stage(MotionEffect)
def farther(pose, theta):
    """It stands farther."""
    return Transform(pose.rotation, pose.translation_m + theta["size"][..., None, None])


@of_stage(MotionEffect, columns=lambda circumstances: circumstances.hours[:, None] + 1.0)
def turned(pose, columns, theta):
    """It turns, and stands farther with time."""
    size = theta["size"][..., None, None]
    turn = rotation_from_vector(size * torch.tensor([0.0, 0.0, 1.0]).double())
    return Transform(turn, pose.translation_m + size * columns / columns)


def added(effect: During, theta, circumstances: Circumstances) -> torch.Tensor:
    """What an effect adds at each reading."""
    zero = torch.zeros(N, 3, dtype=torch.float64)
    if isinstance(effect, ReadingEffect):
        return effect.apply(zero, theta, circumstances, "hall")
    if isinstance(effect, CurrentEffect):
        return effect.apply(zero[:, :1], theta, circumstances, 0)
    if isinstance(effect, RoomEffect):
        return effect.drifting_T(theta, circumstances)
    eye = torch.eye(3, dtype=torch.float64).expand(N, 3, 3)
    return effect.apply(Transform(eye, zero), effect.columns(circumstances, "mapper"), theta).translation_m


@pytest.mark.parametrize(
    "base", [more_shown, more_current, more_field, farther, turned], ids=lambda each: each.name
)
def test_effect_is_there_in_its_part_of_the_session_alone(base, circumstances):
    @during(base, words="since")
    def since():
        """Since."""

    @spell(since, words="meanwhile")
    def meanwhile():
        """Meanwhile."""

    assert (since.kind, since.source, meanwhile.stays) == (base.kind, base.source, since)
    assert [quantity.key for quantity in meanwhile.quantities(Extent())] == ["size", SINCE, UNTIL]
    numbers = {"size": 2.0, SINCE: 0.6, UNTIL: 1.6}
    theta = {key: torch.tensor([value, value], dtype=torch.float64) for key, value in numbers.items()}
    is_since, is_before = circumstances.hours >= 0.6, circumstances.hours < 1.6
    for effect, is_there in ((since, is_since), (meanwhile, is_since & is_before)):
        keys = [quantity.key for quantity in effect.quantities(Extent())]
        change = added(effect, {key: theta[key] for key in keys}, circumstances)
        assert change.shape[0] == 2
        assert (change[1] == 2.0 * is_there[:, None]).all()
        assert effect.starts(circumstances, effect.places(circumstances.rig)[0])


def test_mover_is_turned_in_its_part_of_the_session_alone(circumstances):
    @during(turned, words="since")
    def since():
        """Since."""

    theta = {"size": torch.tensor(0.5).double(), SINCE: torch.tensor(0.6).double()}
    eye = torch.eye(3, dtype=torch.float64).expand(N, 3, 3)
    columns = since.columns(circumstances, "mapper")
    moved = since.apply(Transform(eye, torch.zeros(N, 3, dtype=torch.float64)), columns, theta)
    is_turned = (moved.rotation[:, 0, 0] - torch.cos(theta["size"])).abs() < 1e-12
    assert is_turned.tolist() == (circumstances.hours >= 0.6).tolist()
    assert (moved.rotation[~is_turned] == eye[~is_turned]).all()


def test_an_answer_of_another_shape_than_what_it_changes_is_said_in_one_sentence(circumstances):
    def first_axis(field_sensor_T, theta):
        """The sensor gives one axis."""
        return field_sensor_T[..., 0] * (1.0 + theta["excess"][..., None])

    effect = ReadingEffect.cause(**BENT)(first_axis)
    field_T, theta = torch.zeros(N, 3), {"excess": torch.zeros(())}
    expected = r"first_axis must give as many numbers along the last axis as it is given; it gives \(12,\) for \(12, 3\)"
    with pytest.raises(InvalidInput, match=expected):
        effect.apply(field_T, theta, circumstances, "hall")
