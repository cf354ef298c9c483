"""GrabNet: human grasps of unseen objects (Taheri et al., ECCV 2020)."""

import os
from typing import Any

# torch's threads wait for their next piece of work by spinning, on the cores that our kernels' threads want: a training
# step takes a third longer. Read when torch is first imported, so it helps where this package comes first.
os.environ.setdefault("GOMP_SPINCOUNT", "100")

__all__ = ["Grabber"]


def __getattr__(name: str) -> Any:
    if name != "Grabber":
        raise AttributeError(f"module 'grabnet' has no attribute {name!r}")
    from grabnet.generation.grabber import Grabber  # only when wanted: it takes seconds to import

    return Grabber
