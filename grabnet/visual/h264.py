"""H.264 videos of frames (x264 through PyAV): every browser plays them, and they start before they are whole."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import replacing


def write_video(path: str | Path, frames: Iterable[np.ndarray], size: int, fps: int, quality: int) -> None:
    """Write a video, atomically.

    Args:
        path: .mp4
        frames: uint8 (H, W, 4), RGBA, square, scaled down to `size`; each is read before the next is asked for.
        size: pixels of its side, even.
        fps: frames per second.
        quality: x264's constant rate factor, 0 best … 51 worst.

    Raises:
        UserError: PyAV is not installed.
    """
    av = required_av()
    # One thread each, for as many videos at once as there are cores. (x264 does not give the same bytes each time.)
    # Frames that refer to later ones take a quarter more time, and make no smaller file of a scene that turns evenly.
    options = {"preset": "veryfast", "crf": str(quality), "threads": "1", "bf": "0"}
    with replacing(path) as temporary, av.open(str(temporary), "w", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream("libx264", rate=fps, options=options)
        stream.width = stream.height = size
        stream.pix_fmt = "yuv420p"
        scaler = av.video.reformatter.VideoReformatter()
        for image in frames:
            frame = av.VideoFrame.from_numpy_buffer(image, "rgba")  # without a copy
            container.mux(stream.encode(scaler.reformat(frame, size, size, "yuv420p", interpolation="AREA")))
        container.mux(stream.encode())


def required_av():
    """The module `av`.

    Raises:
        UserError: it is not installed.
    """
    try:
        import av
    except ModuleNotFoundError:
        raise UserError("Videos need PyAV: pip install 'grabnet[study]'.") from None
    return av
