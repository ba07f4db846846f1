"""Fixtures of the small session, and of what the judge reads of it."""

from tests.estimator.conftest import rig_text, small_calibration, small_plan, small_rig, small_session  # noqa: F401
from tests.scripts.judged import folder, printed, told, unseen_uT  # noqa: F401
