"""Human-looking right-hand grasps of the open objects: synthesis, checks, and the file they are shipped in."""

from grabnet.open.grasps.store import OpenGrasps, load_open_grasps

__all__ = ["OpenGrasps", "load_open_grasps"]
