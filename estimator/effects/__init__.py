"""Every cause of a difference between simulation and measurement that coilcal knows, and the corrections for what has no known cause.

Names are stable. Packages outside this repository add causes of their own by the entry-point group `coilcal.effects`, programs by
`register_effect`; the contract is in `effects.base` and `effects.stages`.
"""

from __future__ import annotations

import re
from importlib.metadata import entry_points

from estimator.effects.base import Effect
from estimator.effects.causes.carried import MagnetisedLink
from estimator.effects.causes.core import CoreRemanence, CrossMagnetisation
from estimator.effects.causes.force import CoilPulled
from estimator.effects.causes.iron import IronBody, IronOnSensor, IronPlate, PiercedPlate, SecondIronBody
from estimator.effects.causes.noise import NoiseGrows, Outliers, PositionJitter
from estimator.effects.causes.pose_record import PositionUnit, RotationConvention, RowsShifted
from estimator.effects.causes.record import (
    AxesSwapped,
    CoilsExchanged,
    CurrentSign,
    DisplacementFrameError,
    LeftHanded,
    SensorsExchanged,
    UnitError,
)
from estimator.effects.causes.record_frame import FieldFrame
from estimator.effects.causes.record_since import (
    AxesSwappedSince,
    CoilsExchangedSince,
    CurrentSignSince,
    RowsShiftedSince,
)
from estimator.effects.causes.robot import (
    Backlash,
    JointSag,
    JointZeros,
    MountTilt,
    MoverSlipped,
    PositionLag,
    RobotScale,
    RobotShear,
    SensorBumped,
)
from estimator.effects.causes.segments import SegmentGain, SegmentMisplaced, SegmentZero
from estimator.effects.causes.sensor import (
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
from estimator.effects.causes.sensor_history import (
    ChannelCrosstalk,
    OffsetStep,
    SensorExchanged,
    SensorLag,
    ThermalLag,
)
from estimator.effects.causes.sensor_place import SensorContact
from estimator.effects.causes.spells import (
    BackgroundSpell,
    CurrentSignSpell,
    CurrentSpell,
    GainSpell,
    MoverSpell,
    OffsetSpell,
)
from estimator.effects.causes.stated import (
    BaseMisplaced,
    CoilMisplaced,
    NoiseMisstated,
    SensorMisplaced,
    SidesMisstated,
    WindingMisstated,
)
from estimator.effects.causes.structure import HiddenWinding, ReversedLayer
from estimator.effects.causes.superconductor import FilamentMagnetisation
from estimator.effects.causes.supply import (
    CoilHeating,
    CurrentAsymmetry,
    CurrentCompression,
    CurrentDeadBand,
    CurrentGain,
    CurrentLimit,
    CurrentOffset,
    CurrentRange,
    CurrentRemanence,
    CurrentStep,
    NeighbourCoil,
)
from estimator.effects.causes.surroundings import (
    BackgroundDrift,
    BackgroundField,
    BackgroundGradient,
    BackgroundStep,
    PeriodicInterference,
)
from estimator.effects.causes.winding import (
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
    WindingSheared,
)
from estimator.effects.circumstances import Extent
from estimator.effects.corrections.bore import CoilBore, RoomBore
from estimator.effects.corrections.drift import (
    CurrentWanders,
    GuidesWander,
    ResponseWanders,
    RoomWanders,
    TurnsWander,
    ZeroWanders,
)
from estimator.effects.corrections.guide import GuideErrors
from estimator.effects.corrections.harmonics import (
    CoilHarmonics,
    CoilMultipoles,
    RoomAnswers,
    RoomHarmonics,
)
from estimator.effects.corrections.history import CurrentRemembered, FieldRemembered, SidesRemembered
from estimator.effects.corrections.levels import AxisSteps, GainSteps
from estimator.effects.corrections.memory import MovesRemembered
from estimator.effects.corrections.periodic import CurrentSwings, GuideSwings, ReadingRipples, ZeroSwings
from estimator.effects.corrections.place import ResponseByPlace
from estimator.effects.corrections.response import AxisCurves, CurrentPickup, GainCurve, SensorResponse
from estimator.effects.corrections.steps import (
    CurrentSteps,
    GuidesStep,
    ResponseSteps,
    RoomSteps,
    ZeroSteps,
)
from estimator.effects.corrections.turning import TurnsByAngle
from estimator.effects.stages import CurrentEffect
from estimator.errors import InvalidInput, closest, quoted

# In the order in which a reading comes about; those of one stage are applied in this order.
EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        CoilsExchanged(),
        CoilsExchangedSince(),
        CurrentSign(),
        CurrentSignSince(),
        CurrentSignSpell(),
        CurrentGain(),
        CurrentOffset(),
        CurrentDeadBand(),
        CurrentAsymmetry(),
        CurrentCompression(),
        CurrentLimit(),
        CurrentRange(),
        CurrentStep(),
        CurrentSpell(),
        CurrentRemanence(),
        CoilHeating(),
        NeighbourCoil(),
        WindingMisstated(),
        SidesMisstated(),
        AxialPitch(),
        RadialPitch(),
        TurnsGradient(),
        ShortLayer(),
        ReversedLayer(),
        HiddenWinding(),
        CoilOvality(),
        WindingSheared(),
        LeadWire(),
        IronCore(),
        CoreSaturation(),
        CrossMagnetisation(),
        CoreRemanence(),
        SphericalSum(),
        DipoleModel(),
        MagnetisedLink(),
        FilamentMagnetisation(),
        BackgroundField(),
        BackgroundGradient(),
        BackgroundDrift(),
        BackgroundStep(),
        BackgroundSpell(),
        PeriodicInterference(),
        IronPlate(),
        PiercedPlate(),
        IronBody(),
        SecondIronBody(),
        PositionUnit(),
        RotationConvention(),
        LeftHanded(),
        DisplacementFrameError(),
        RobotScale(),
        RobotShear(),
        PositionLag(),
        Backlash(),
        JointZeros(),
        JointSag(),
        BaseMisplaced(),
        MoverSlipped(),
        MoverSpell(),
        SegmentMisplaced(),
        MountTilt(),
        SensorBumped(),
        IronOnSensor(),
        CoilPulled(),
        SensorMisplaced(),
        CoilMisplaced(),
        ElementDisplacement(),
        CrossAxis(),
        AxisGain(),
        GainSpell(),
        CubicResponse(),
        PlanarHall(),
        TemperatureDrift(),
        ThermalLag(),
        SensorOffset(),
        OffsetDrift(),
        OffsetStep(),
        OffsetSpell(),
        SensorExchanged(),
        SensorContact(),
        SegmentGain(),
        SegmentZero(),
        RangeClipping(),
        AxesSwapped(),
        AxesSwappedSince(),
        FieldFrame(),
        SensorLag(),
        ChannelCrosstalk(),
        SensorsExchanged(),
        RowsShifted(),
        RowsShiftedSince(),
        UnitError(),
        NoiseMisstated(),
        Outliers(),
        NoiseGrows(),
        PositionJitter(),
        CurrentWanders(),
        CurrentSwings(),
        CurrentSteps(),
        CurrentRemembered(),
        CoilHarmonics(),
        CoilMultipoles(),
        CoilBore(),
        RoomHarmonics(),
        RoomBore(),
        RoomAnswers(),
        RoomWanders(),
        RoomSteps(),
        GuideErrors(),
        GuidesWander(),
        GuideSwings(),
        GuidesStep(),
        MovesRemembered(),
        SidesRemembered(),
        SensorResponse(),
        ResponseByPlace(),
        AxisCurves(),
        GainCurve(),
        AxisSteps(),
        GainSteps(),
        CurrentPickup(),
        ReadingRipples(),
        ResponseWanders(),
        TurnsWander(),
        TurnsByAngle(),
        ZeroWanders(),
        ZeroSwings(),
        ZeroSteps(),
        ResponseSteps(),
        FieldRemembered(),
    )
}
ORDER = {name: i for i, name in enumerate(EFFECTS)}
ENTRY_POINTS = "coilcal.effects"
NAME = re.compile(r"[a-z][a-z0-9_]*")  # of causes, as rig files write them


def register_effect(effect: object) -> None:
    """Make a cause known to everything: simulation, diagnosis, rig files, prediction.

    It acts after those of the library that share its stage. Other processes do not know of it: what workers, the live view or the command
    line should know comes from a package with an entry point in the group `coilcal.effects`.

    Args:
        effect: Of one of the stages in `estimator.effects.stages`.
    Raises:
        InvalidInput: It is no effect of a stage, its declaration is incomplete, or its name is taken.
    Examples:
        >>> register_effect(CurrentGain())
        Traceback (most recent call last):
        estimator.errors.InvalidInput: effect must have a name of its own; received 'current_gain', which is taken
    """
    if not isinstance(effect, Effect) or type(effect).__mro__[1] is Effect:
        raise InvalidInput(
            f"effect must be an instance of a stage in estimator.effects.stages; received {effect!r}"
        )
    missing = [key for key in ("name", "kind", "words", "source") if not getattr(effect, key, None)]
    if missing:
        raise InvalidInput(
            f"effect must declare {' and '.join(missing)}; received {type(effect).__name__} without"
        )
    if not NAME.fullmatch(effect.name):
        raise InvalidInput(f"effect must be named by small letters, digits and _; received {effect.name!r}")
    if effect.name in EFFECTS:
        raise InvalidInput(f"effect must have a name of its own; received {effect.name!r}, which is taken")
    for quantity in effect.quantities(Extent()):
        suffix = quantity.unit.replace(" ", "_").replace("/", "_per_").replace("1_per_", "per_")
        if quantity.unit != "1" and not quantity.key.endswith(suffix):
            raise InvalidInput(
                f"quantity of {effect.name} must end in its unit {suffix}; received {quantity.key!r}"
            )
    EFFECTS[effect.name] = effect
    ORDER[effect.name] = len(ORDER)


def _register_installed() -> None:
    """Causes of installed packages."""
    for point in entry_points(group=ENTRY_POINTS):
        try:
            declared = point.load()
            register_effect(declared() if isinstance(declared, type) else declared)
        except Exception as error:
            raise InvalidInput(
                f"plug-in {point.name!r} of {ENTRY_POINTS} must load ({point.value}); received {type(error).__name__}: {error}"
            ) from error


_register_installed()

COUPLING = next(
    effect for effect in EFFECTS.values() if isinstance(effect, CurrentEffect) and effect.couples_coils
)
"""The cause by which one coil drives another, which a test of superposition asks for first."""


def closest_cause(name: str) -> str:
    """The cause that may have been meant, or where all stand, as the end of a sentence."""
    return closest(name, EFFECTS) or "; 'coilcal explain' lists them"


def effect_of(name: str) -> Effect:
    """The effect of that name.

    Raises:
        InvalidInput: There is none; the message names the closest.
    """
    if name not in EFFECTS:
        raise InvalidInput(
            f"cause must be one that coilcal knows; received {quoted(name)}{closest_cause(name)}"
        )
    return EFFECTS[name]
