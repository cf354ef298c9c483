"""Reading and writing .c3d files, the exchange format of motion capture (ref. 12); ezc3d does the decoding."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import existing, replacing
from grabnet.mosh.markers import MarkerData, markers_of

_BLOCK = 512  # bytes
_MOST_FRAMES = 0xFFFF  # that ezc3d reads and writes; the header has 16 bits for them
_MIPS = 86  # what the processor's number is in files of old SGI workstations
# Groups of POINT in which capture software lists points that are no markers.
_NO_MARKERS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS")


def read_c3d(path: str | Path, unit: str | None = None, up: str = "z") -> MarkerData:
    """Markers of a file, in metres.

    Missing are points that are NaN, exactly 0, or have a negative residual.

    Args:
        path: of the file.
        unit: replaces the file's own.
        up: the file's vertical axis.

    Raises:
        UserError: ezc3d is not installed; no c3d file, cut off, of an SGI/MIPS machine; as `markers_of`.
    """
    path = existing(path, "Capture")
    _check_header(path)
    content = _ezc3d().c3d
    try:
        file = content(str(path))
    except Exception as error:  # ezc3d raises what its C++ code throws
        raise UserError(f"{path} cannot be read as c3d ({' '.join(str(error).split())[:120]}).") from None
    parameters = file["parameters"].get("POINT", {})
    points = np.moveaxis(file["data"]["points"][:3], 0, -1).swapaxes(0, 1).astype(np.float64)
    residuals = file["data"]["meta_points"]["residuals"]
    if residuals.size and residuals.shape[-2:] == points.shape[1::-1]:
        points[residuals[0].T < 0] = np.nan
    units = _texts(parameters, "UNITS")
    return markers_of(
        path,
        _texts(parameters, "LABELS"),
        points,
        float(np.ravel(_value(parameters, "RATE", [np.nan]))[0]) if points.size else 1.0,
        units if len(units) > 1 else (units or [""])[0],
        unit,
        [label for group in _NO_MARKERS for label in _texts(parameters, group)],
        up,
    )


def c3d_frames(path: Path) -> int:
    """About how many frames a file has: by its header, or by its size where they are more than the header can say."""
    with path.open("rb") as file:
        data = file.read(_BLOCK)
    if len(data) < _BLOCK:
        return 0
    points, analog, first, last = struct.unpack("<4H", data[2:10])
    return last - first + 1 if last < 0xFFFF else path.stat().st_size // max(1, 4 * (4 * points + analog))


def write_c3d(path: str | Path, labels: Sequence[str], positions: np.ndarray, rate: float, unit: str = "mm") -> None:
    """Write markers as a c3d file, atomically.

    Args:
        path: of the file.
        labels: one per marker, with prefixes.
        positions: (T, M, 3) metres; NaN where missing.
        rate: frames per second.
        unit: mm or m, of the file.

    Raises:
        UserError: ezc3d is not installed; more frames than a file takes.
    """
    if len(positions) > _MOST_FRAMES:
        raise UserError(f"{path} would have {len(positions):,} frames; a c3d file takes {_MOST_FRAMES:,}.")
    file = _ezc3d().c3d()
    values = np.moveaxis(positions * {"mm": 1e3, "m": 1.0}[unit], -1, 0).swapaxes(1, 2)
    seen = np.isfinite(values).all(0)
    homogeneous = np.concatenate([values, np.ones((1, *seen.shape))])
    homogeneous[:3, ~seen] = np.nan
    file["parameters"]["POINT"]["RATE"]["value"] = [float(rate)]
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["LABELS"]["value"] = [*labels]
    file["data"]["points"] = homogeneous
    file["data"]["meta_points"] = {
        "residuals": np.where(seen, 0.0, -1.0)[None],
        "camera_masks": np.zeros((7, *seen.shape), bool),
    }
    with replacing(path) as temporary:
        file.write(str(temporary))


def _ezc3d() -> Any:
    try:
        import ezc3d
    except ImportError:
        raise UserError("c3d files need ezc3d: pip install -e '.[mosh]'.") from None
    return ezc3d


def _check_header(path: Path) -> None:
    """Refuse what the decoder would crash on or misread: other files, cut-off ones, those of MIPS machines."""
    data = path.open("rb").read(_BLOCK)
    if len(data) < _BLOCK or data[1] != 0x50 or not data[0]:
        raise UserError(f"{path} is no c3d file: it lacks the format's first two bytes.")
    with path.open("rb") as file:
        file.seek(_BLOCK * (data[0] - 1))
        parameters = file.read(4)
    if len(parameters) < 4:
        raise UserError(f"{path} is cut off within its header: copy it again.")
    if parameters[3] == _MIPS:
        raise UserError(
            f"{path} was written by an SGI/MIPS machine, whose numbers are not read: save it as PC (Intel)."
        )
    points, analog, first, last = struct.unpack("<4H", data[2:10])
    integers = struct.unpack("<f", data[12:16])[0] > 0 if parameters[3] == 84 else data[15] < 0x80
    start = struct.unpack("<H", data[16:18])[0]
    size, data_at = path.stat().st_size, _BLOCK * (start - 1)
    if not (start and points + analog):
        return
    if points and size <= data_at:
        raise UserError(f"{path} holds no frames: it ends where they should start. Export or copy it again.")
    if last < first and last:
        raise UserError(f"{path} holds 0 frames.")
    frame_bytes = (4 * points + analog) * (2 if integers else 4)
    more = last in (0, _MOST_FRAMES)  # than the header can say
    frames = _announced(path, _BLOCK * (data[0] - 1), data_at) if more else last - first + 1
    if size < (expected := data_at + frames * frame_bytes):
        raise UserError(f"{path} is cut off: it has {size:,} bytes of the {expected:,} that its header announces.")
    if points and (size - data_at - _BLOCK) // frame_bytes > _MOST_FRAMES:  # a block may be padding
        raise UserError(f"{path} has more than the {_MOST_FRAMES:,} frames that are read of a c3d file: export parts.")


def _announced(path: Path, start: int, end: int) -> int:
    """Frames that the parameters between two bytes of the file announce, in the words that long files use."""
    with path.open("rb") as file:
        file.seek(start)
        parameters = file.read(max(0, end - start))
    for name in (b"ACTUAL_END_FIELD", b"FRAMES"):
        value = parameters[parameters.find(name) + len(name) + 2 :] if name in parameters else b""
        if len(value) >= 6 and value[0] == 2:  # 16-bit integers, one or two of them: low and high word
            at, n = (2, 1) if value[1] == 0 else (3, value[2])
            words = struct.unpack_from(f"<{min(n, 2)}H", value, at)
            return sum(word << 16 * k for k, word in enumerate(words))
    return 0


def _value(parameters: Any, name: str, default: Any) -> Any:
    return parameters[name]["value"] if name in parameters and len(parameters[name]["value"]) else default


def _texts(parameters: Any, name: str) -> list[str]:
    """The texts of a parameter and of those that continue it, as LABELS2 continues LABELS."""
    continued = [name, *(f"{name}{k}" for k in range(2, 20))]
    return [str(text) for key in continued for text in np.ravel(_value(parameters, key, []))]
