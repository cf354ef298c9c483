"""How other processes see that a run has ended. Imported by Hydra's plugins: nothing slow to import is used here."""

from __future__ import annotations

METRICS = "metrics.json"  # written last: where a run folder has it, the run is complete


class RunPruned(Exception):  # noqa: N818, not an error: it ends the run
    """Raised within a run that is not worth going on with; the message says why."""
