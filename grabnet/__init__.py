"""GrabNet: human grasps of unseen objects (Taheri et al., ECCV 2020)."""

from typing import Any

__all__ = ["Grabber"]


def __getattr__(name: str) -> Any:
    if name != "Grabber":
        raise AttributeError(f"module 'grabnet' has no attribute {name!r}")
    from grabnet.models.grabber import Grabber  # only when wanted: it takes seconds to import

    return Grabber
