"""The socket between `coilcal --via local` and the process that carries out its command; both ends check whom they speak with.

It lies in a folder that no other user can enter. The folder is opened once, without following a link, and everything in it is reached
through that descriptor: what somebody puts into the place of its path changes nothing, and a long path does not matter.
"""

from __future__ import annotations

import json
import locale
import os
import resource
import socket
import stat
import struct
import sys
from pathlib import Path
from typing import Any

from estimator.errors import InvalidInput

PRIVATE = 0o700
LONGEST_REQUEST = 2**24  # bytes; the system takes no longer arguments and variables of a command by far
ROOT = Path(__file__).resolve().parents[2]
# Variables that libraries read when they are loaded, which happened before. `--threads` decides on OMP_NUM_THREADS.
READ_EARLY = (
    *("CUDA_", "GOMP_", "HOME", "KMP_", "LD_", "MALLOC_", "MKL_", "MPL", "NUMBA_", "OMP_", "OPENBLAS_"),
    *("PYTHON", "PYTORCH_", "TORCH", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"),
)
DECIDED = "OMP_NUM_THREADS"
LIMITS = (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_DATA, resource.RLIMIT_FSIZE)


def folder_path() -> Path:
    """Path of the folder of the sockets: in that of the user's login session, or with the caches where there is none."""
    given = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    if given.is_absolute():
        return given / "coilcal"
    from platformdirs import user_cache_path

    return user_cache_path("coilcal") / "run"


def opened_folder(is_made: bool = False) -> int:
    """Descriptor of the folder of the sockets.

    Args:
        is_made: Make it where it is missing.
    Raises:
        InvalidInput: Others can enter it, or it is somebody else's.
        OSError: It is missing or a link.
    """
    path = folder_path()
    if is_made:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir(mode=PRIVATE, exist_ok=True)
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    about = os.fstat(folder)
    if about.st_uid != os.geteuid() or stat.S_IMODE(about.st_mode) != PRIVATE:
        os.close(folder)
        raise InvalidInput(f"folder must be yours and closed to all others (mode 700); received {path}")
    return folder


def address(folder: int, kind: str) -> str:
    """Path of a socket for `bind` and `connect`, which take about a hundred characters."""
    return f"/proc/self/fd/{folder}/{kind}"


def is_own(connection: socket.socket) -> bool:
    """Whether the process at the other end is this user's, by what the system says of it."""
    told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return bool(struct.unpack("3i", told)[1] == os.geteuid())


def circumstances() -> dict[str, Any]:
    """What must be the same for a command to give the same result in another process, by the words for it."""
    early = {k: v for k, v in os.environ.items() if k.startswith(READ_EARLY) and k != DECIDED}
    flags = [*sys.flags, *sys.warnoptions, sys.getfilesystemencoding(), locale.getencoding()]
    return {
        "code": str(ROOT),
        "Python": [sys.version, sys.prefix, sys.path[1:], flags],
        "user or groups": [os.getresuid(), os.getresgid(), sorted(os.getgroups())],
        "file systems": [
            str(Path("/proc/self/ns/mnt").readlink()),
            Path("/").stat().st_ino,
            Path("/").stat().st_dev,
        ],
        "limits": [resource.getrlimit(limit)[0] for limit in LIMITS],
        "environment": early,
        "matplotlibrc": os.path.lexists(
            "matplotlibrc"
        ),  # in the current folder, where matplotlib looks when it is loaded
    }


def send_line(connection: socket.socket, content: object) -> None:
    """Send an answer."""
    connection.sendall(json.dumps(content).encode() + b"\n")


def send_request(connection: socket.socket, request: object, descriptors: list[int]) -> None:
    """Send what a command needs, open files among it."""
    body = json.dumps(request).encode()
    socket.send_fds(connection, [struct.pack("!I", len(body))], descriptors)
    connection.sendall(body)


def receive_request(connection: socket.socket, n_descriptors: int) -> tuple[dict[str, Any], list[int]]:
    """What `send_request` sent.

    Raises:
        ValueError: It is no request.
        OSError: The other end is gone, or silent for too long.
    """
    size, descriptors, _, _ = socket.recv_fds(connection, struct.calcsize("!I"), n_descriptors)
    if len(size) != struct.calcsize("!I") or len(descriptors) != n_descriptors:
        raise ValueError
    length, body = struct.unpack("!I", size)[0], bytearray()
    while length <= LONGEST_REQUEST and len(body) < length:
        piece = connection.recv(length - len(body))
        if not piece:
            break
        body += piece
    if len(body) != length:
        raise ValueError
    request: dict[str, Any] = json.loads(body)
    return request, descriptors
