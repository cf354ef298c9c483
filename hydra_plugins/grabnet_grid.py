"""Hydra plugin: all combinations of the swept values (`hydra/sweeper=grid`)."""

from __future__ import annotations

import itertools

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from grabnet.sweeps.runs import Run, folder_name
from grabnet.sweeps.sweeper import RunSweeper, fixed


class GridSweeper(RunSweeper):
    """Runs `model.latent_dim=8,16 seed=0,1` as four runs, in folders named by the values."""

    def run_all(self, overrides: list[Override]) -> list[Run]:
        swept = [o for o in overrides if o.is_sweep_override()]
        if endless := [o for o in swept if not o.is_discrete_sweep()]:
            raise HydraException(f"A grid has no place for {endless[0].input_line}: give values, as in key=1,2,3.")
        keys = [o.get_key_element() for o in swept]
        runs = []
        for combination in itertools.product(*(list(o.sweep_string_iterator()) for o in swept)):
            values = dict(zip(keys, combination, strict=True))
            lines = (*fixed(overrides), *(f"{key}={value}" for key, value in values.items()))
            runs.append(Run(self.folder / folder_name(lines, values), lines, values))
        self.launch(runs)
        return runs
