"""A client of `coilcal serve` that mirrors the Python API, so that a script moves from local to remote by one line.

    calibration = estimator.calibrate(session)                              # here
    calibration = Client("http://127.0.0.1:8765").calibrate(session)             # there
    calibration = await AsyncClient("http://127.0.0.1:8765").calibrate(session)  # there, while other tasks go on

Needs the extra `coilcal[client]`, or `coilcal[service]`.
"""

from estimator.client.calibrations import AsyncRemoteCalibration, RemoteCalibration
from estimator.client.client import AsyncClient, Client
from estimator.client.connection import JobFailed, ServiceFault
from estimator.client.diagnoses import RemoteDiagnosis
from estimator.client.registry import AsyncRemoteRegistry, RemoteRegistry
from estimator.client.sessions import AsyncRemoteSession, RemoteSession

__all__ = [
    "AsyncClient",
    "AsyncRemoteCalibration",
    "AsyncRemoteRegistry",
    "AsyncRemoteSession",
    "Client",
    "JobFailed",
    "RemoteCalibration",
    "RemoteDiagnosis",
    "RemoteRegistry",
    "RemoteSession",
    "ServiceFault",
]
