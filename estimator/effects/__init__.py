"""Every cause of a difference between simulation and measurement that coilcal knows; names are stable (DESIGN section 5)."""

from __future__ import annotations

from difflib import get_close_matches

from estimator.effects.base import CurrentEffect, Effect
from estimator.effects.iron import IronBody, IronPlate, PiercedPlate
from estimator.effects.noise import Outliers, PositionJitter
from estimator.effects.record import (
    AxesSwapped,
    CurrentSign,
    DisplacementFrameError,
    LeftHanded,
    UnitError,
)
from estimator.effects.robot import (
    Backlash,
    MountTilt,
    PositionLag,
    RobotScale,
    RobotShear,
    SensorBumped,
    SensorMisplaced,
)
from estimator.effects.sensor import (
    AxisGain,
    CrossAxis,
    CubicResponse,
    ElementDisplacement,
    OffsetDrift,
    PlanarHall,
    RangeClipping,
    SensorOffset,
    TemperatureDrift,
)
from estimator.effects.superconductor import FilamentMagnetisation
from estimator.effects.supply import CoilHeating, CurrentGain, CurrentOffset, NeighbourCoil
from estimator.effects.surroundings import BackgroundDrift, BackgroundField
from estimator.effects.winding import (
    AxialPitch,
    CoilOvality,
    CoreSaturation,
    DipoleModel,
    IronCore,
    LeadWire,
    RadialPitch,
    ShortLayer,
    SphericalSum,
    TurnsGradient,
)
from estimator.errors import InvalidInput

# In the order in which a reading comes about; those of one stage are applied in this order.
EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        CurrentSign(),
        CurrentGain(),
        CurrentOffset(),
        CoilHeating(),
        NeighbourCoil(),
        AxialPitch(),
        RadialPitch(),
        TurnsGradient(),
        ShortLayer(),
        CoilOvality(),
        LeadWire(),
        IronCore(),
        CoreSaturation(),
        SphericalSum(),
        DipoleModel(),
        FilamentMagnetisation(),
        BackgroundField(),
        BackgroundDrift(),
        IronPlate(),
        PiercedPlate(),
        IronBody(),
        LeftHanded(),
        DisplacementFrameError(),
        RobotScale(),
        RobotShear(),
        PositionLag(),
        Backlash(),
        MountTilt(),
        SensorBumped(),
        SensorMisplaced(),
        ElementDisplacement(),
        CrossAxis(),
        AxisGain(),
        CubicResponse(),
        PlanarHall(),
        TemperatureDrift(),
        SensorOffset(),
        OffsetDrift(),
        RangeClipping(),
        AxesSwapped(),
        UnitError(),
        Outliers(),
        PositionJitter(),
    )
}
ORDER = {name: i for i, name in enumerate(EFFECTS)}


COUPLING = next(
    effect for effect in EFFECTS.values() if isinstance(effect, CurrentEffect) and effect.couples_coils
)
"""The cause by which one coil drives another, which a test of superposition asks for first."""


def effect_of(name: str) -> Effect:
    """The effect of that name.

    Raises:
        InvalidInput: There is none; the message names the closest.
    """
    if name not in EFFECTS:
        closest = get_close_matches(name, EFFECTS, n=1, cutoff=0.0)
        raise InvalidInput(
            f"cause must be one that coilcal knows; received {name!r}, the closest is {' '.join(closest)}"
        )
    return EFFECTS[name]
