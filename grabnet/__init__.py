"""GrabNet: human grasps of unseen objects (Taheri et al., ECCV 2020)."""

import os
from importlib import import_module, metadata
from typing import Any

# torch's threads wait for their next piece of work by spinning, on the cores that our kernels' threads want: a training
# step takes a third longer. Read when torch is first imported, so it helps where this package comes first.
os.environ.setdefault("GOMP_SPINCOUNT", "100")

# Imported at first use: torch alone takes seconds.
_HOMES = {
    "Grabber": "grabnet.generation.grabber",
    "Grasps": "grabnet.generation.grasps",
    "HandModel": "grabnet.body.hand",
    "HandParameters": "grabnet.body.hand",
    "Mesh": "grabnet.geometry.mesh",
    "UserError": "grabnet.errors",
    "load_mesh": "grabnet.geometry.mesh",
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("grabnet")
    if name not in _HOMES:
        raise AttributeError(f"module 'grabnet' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
