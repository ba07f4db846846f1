"""The public names, as type checkers and editors see them; `__init__.py` loads each when it is first used."""

from estimator.batching import batch as batch
from estimator.calibration.calibrate import Stage as Stage
from estimator.calibration.calibrate import calibrate as calibrate
from estimator.calibration.result import Calibration as Calibration
from estimator.diagnosis.diagnose import diagnose as diagnose
from estimator.diagnosis.next_readings.design import Design as Design
from estimator.diagnosis.next_readings.design import design as design
from estimator.diagnosis.result import Diagnosis as Diagnosis
from estimator.effects import register_effect as register_effect
from estimator.errors import (
    CoilcalError as CoilcalError,
)
from estimator.errors import (
    CorruptStore as CorruptStore,
)
from estimator.errors import (
    InvalidInput as InvalidInput,
)
from estimator.inference.ensemble import SamplerSettings as SamplerSettings
from estimator.live.stream import Estimate as Estimate
from estimator.live.stream import Stream as Stream
from estimator.model.simulate import draw_truth as draw_truth
from estimator.model.simulate import simulate as simulate
from estimator.planning.next_stop import NextStop as NextStop
from estimator.planning.next_stop import next_stop as next_stop
from estimator.planning.plan import plan as plan
from estimator.planning.planned import Planned as Planned
from estimator.readings.observations import Observations as Observations
from estimator.readings.plan import Plan as Plan
from estimator.readings.plan import load_plan as load_plan
from estimator.readings.split import block_split as block_split
from estimator.recalibration.log import Entry as Entry
from estimator.recalibration.recalibrate import recalibrate as recalibrate
from estimator.recalibration.recalibrate import roll_back as roll_back
from estimator.recalibration.registry import Registry as Registry
from estimator.rig.rig import Rig as Rig
from estimator.rig_files.read import load_rig as load_rig
from estimator.store.session import Session as Session
from estimator.store.session import load_session as load_session
from estimator.system.superposition import Superposition as Superposition
from estimator.system.superposition import superposition as superposition
from estimator.system.system import System as System
from estimator.system.system_field import SystemField as SystemField

DISTRIBUTION: str
