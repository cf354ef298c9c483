"""CoACD in a process of its own: `python -m grabnet.physics.coacd_process FOLDER` cuts the mesh that lies there.

What CoACD cannot do it ends the process for, or never ends; so it is not run where other things would go with it.
FOLDER holds mesh.npz (vertices, faces) and options.json, for `coacd.run_coacd`; pieces.npz is put there: the corners of
all pieces after each other, and how many each has.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np


class CoacdError(RuntimeError):
    """CoACD did not cut a mesh; the message says why."""


def cut(vertices: np.ndarray, faces: np.ndarray, time_limit: float, **options: Any) -> list[np.ndarray]:
    """Corners (N, 3) float32 of convex pieces of a mesh.

    Args:
        vertices: (V, 3). faces: (F, 3).
        time_limit: seconds.
        options: of `coacd.run_coacd`.

    Raises:
        CoacdError: it took longer, or ended without result.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "mesh.npz", vertices=np.asarray(vertices, np.float64), faces=faces)
        (folder / "options.json").write_text(json.dumps(options), encoding="utf-8")
        command = [sys.executable, "-m", __name__, str(folder)]
        paths = os.pathsep.join(path for path in sys.path if path)
        # One thread: its result might depend on how many there are, and other objects are cut meanwhile.
        settings = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": paths}
        try:
            done = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=time_limit)
        except subprocess.TimeoutExpired:
            raise CoacdError(f"CoACD was not done after {time_limit:g} s") from None
        result = folder / "pieces.npz"
        if done.returncode or not result.exists():
            said = (done.stderr + done.stdout).strip().splitlines()
            raise CoacdError(f"CoACD ended with code {done.returncode}" + (f" ({said[-1].strip()})" if said else ""))
        with np.load(result) as found:
            return np.split(found["corners"], np.cumsum(found["counts"])[:-1]) if len(found["counts"]) else []


def _main(folder: Path) -> None:
    import coacd  # here: an extra

    coacd.set_log_level("error")
    options = json.loads((folder / "options.json").read_text(encoding="utf-8"))
    with np.load(folder / "mesh.npz") as mesh:
        parts = coacd.run_coacd(coacd.Mesh(mesh["vertices"], mesh["faces"]), **options)
    corners = [np.asarray(vertices, np.float32) for vertices, _ in parts]
    counts = np.array([len(piece) for piece in corners], np.int64)
    np.savez(folder / "pieces.npz", corners=np.concatenate([np.empty((0, 3), np.float32), *corners]), counts=counts)


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
