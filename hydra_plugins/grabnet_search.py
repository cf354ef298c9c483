"""Hydra plugin: Optuna chooses the values (`hydra/sweeper=search`)."""

from __future__ import annotations

from typing import Any

from hydra.core.override_parser.types import IntervalSweep, Override

from grabnet.errors import UserError
from grabnet.io.recipes import claim
from grabnet.sweeps.runs import DONE, PRUNED, Run
from grabnet.sweeps.sweeper import RunSweeper, fixed

STUDY = "study.log"


class SearchSweeper(RunSweeper):
    """Minimises the objective over lists of values, `interval(low, high)`, `int(interval(low, high))` and, on a
    logarithmic scale, `tag(log, interval(low, high))`.

    The study is kept in the sweep's folder after every run: a killed search goes on where it was, and the next command
    tries again what failed.

    Args:
        n_trials: runs in all, those of earlier commands in the same folder included.
        n_jobs: runs launched at once; the launcher decides whether they run at the same time.
        n_startup: random ones at the beginning.
        seed: of the choices.
        params: the search space, which the command line adds to.
    """

    def __init__(self, n_trials: int, n_jobs: int, n_startup: int, seed: int, params: dict[str, str] | None = None):
        super().__init__(params)
        self.n_trials, self.n_jobs, self.n_startup, self.seed = n_trials, n_jobs, n_startup, seed

    def run_all(self, overrides: list[Override]) -> list[Run]:
        for name, least in {"n_trials": 1, "n_jobs": 1, "n_startup": 0, "seed": 0}.items():
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise UserError(f"hydra.sweeper.{name}={value} is not to be had; give a whole number from {least} up.")
        space = {o.get_key_element(): _distribution(o) for o in overrides if o.is_sweep_override()}
        if not space:
            raise UserError("There is nothing to search: name values, as in model.optimizer.lr='interval(1e-4,1e-3)'.")
        lines = fixed(overrides)
        study = self._study(lines)
        self._check_space(study, space)

        def run(trial: Any) -> Run:
            values = {key: str(value) for key, value in trial.params.items()}
            told = (*lines, *(f"{key}={value}" for key, value in values.items()))
            return Run(self.folder / f"trial_{trial.number:03d}", told, values)

        begun = [t for t in study.trials if not t.state.is_finished()]  # by an earlier command
        while True:
            batch, begun = begun[: self.n_jobs], begun[self.n_jobs :]
            new = min(self.n_jobs - len(batch), self.n_trials - len(study.trials))
            batch += [study.ask(space) for _ in range(new)]
            if not batch:
                return [run(trial) for trial in study.trials]
            runs = [run(trial) for trial in batch]
            self.launch(runs)
            for trial, ended in zip(batch, runs, strict=True):
                self._tell(study, trial.number, ended)

    def _study(self, lines: list[str]) -> Any:
        """The study in the sweep's folder, begun where there is none."""
        optuna = _optuna()
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        settings = {key: value for key, _, value in (line.partition("=") for line in lines) if key != "sweep_dir"}
        claim(self.folder / "recipe.json", settings, "give the same, or another sweep_dir")
        file = optuna.storages.journal.JournalFileBackend(str(self.folder / STUDY))
        study = optuna.create_study(
            storage=optuna.storages.JournalStorage(file), study_name="search", load_if_exists=True
        )
        # A sampler that began with the same seed again would propose the first values again.
        study.sampler = optuna.samplers.TPESampler(
            seed=self.seed + len(study.trials), n_startup_trials=self.n_startup, multivariate=True, constant_liar=True
        )
        return study

    def _check_space(self, study: Any, space: dict[str, Any]) -> None:
        """Keys may come and go and intervals change from command to command, but not a list or the kind of values."""
        for trial in study.trials:
            for key in space.keys() & trial.distributions.keys():
                begun, now = trial.distributions[key], space[key]
                try:
                    _optuna().distributions.check_distribution_compatibility(begun, now)
                except ValueError:
                    raise UserError(
                        f"The search in {self.folder} was begun with {key} from {begun}, which cannot become {now}: "
                        f"give the same, or another sweep_dir."
                    ) from None

    def _tell(self, study: Any, number: int, run: Run) -> None:
        """Record what became of a trial; one that failed or did not come back stays open for the next command."""
        if run.status == DONE:
            study.tell(number, run.metrics()[self.config.objective])
        elif run.status == PRUNED:
            study.tell(number, state=_optuna().trial.TrialState.PRUNED)


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise UserError("A search needs Optuna: pip install -e '.[sweeps]'.") from None
    return optuna


def _distribution(override: Override) -> Any:
    distributions = _optuna().distributions
    if override.is_discrete_sweep():
        return distributions.CategoricalDistribution(list(override.sweep_string_iterator()))
    interval = override.value()
    assert isinstance(interval, IntervalSweep)
    low, high, log = interval.start, interval.end, "log" in interval.tags
    if isinstance(low, int) and isinstance(high, int):
        return distributions.IntDistribution(low, high, log=log)
    return distributions.FloatDistribution(low, high, log=log)
