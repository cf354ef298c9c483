"""The primary test: an ordinal mixed model with crossed effects of raters and grasps, by NumPyro's NUTS.

A rating exceeds a level with log odds η less the level's cutpoint:
η = object + (condition's difference from the first, by object) + rater + (rater's own difference) + grasp.

Raters, their own differences of each condition, and grasps are drawn from normal distributions, whose deviations are
estimated, too. Objects are those of the study, not drawn from others: a condition's difference is its mean over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from grabnet.cli.checks import Concurrent, Range, in_range
from grabnet.errors import UserError
from grabnet.evaluation.bootstrap import Estimate
from grabnet.study.scores import Ratings

# Chains are trusted below this ratio of variances between and within (Vehtari et al., Bayesian Analysis 2021: 1.01;
# ours are short).
_MAX_R_HAT = 1.05


@dataclass(frozen=True)
class ModelConfig:
    """How the model is fitted.

    warmup, draws: of each chain.
    chains: run side by side.
    """

    warmup: Annotated[int, Range(50, 100_000)]
    draws: Annotated[int, Range(50, 100_000)]
    chains: Concurrent

    def __post_init__(self):
        in_range(self, "model.")


@dataclass(frozen=True, eq=False)
class OrdinalFit:
    """What the model finds.

    differences: log odds of a better rating than the first condition gets, by condition and object; `None` for the mean
        over objects.
    deviations: standard deviations of the effects, on the scale of log odds.
    caution: why the chains are not to be trusted; empty where they are.
    """

    differences: dict[tuple[str, str | None], Estimate]
    deviations: dict[str, Estimate]
    caution: str


def fit(ratings: Ratings, config: ModelConfig, seed: int) -> OrdinalFit:
    """Fit the model.

    Args:
        ratings: of raters who count, of two conditions at least.
        config: of the chains.
        seed: of these.

    Raises:
        UserError: NumPyro is not installed, or there are not two conditions or levels in use.
    """
    numpyro, jax = _required()
    if len(ratings.conditions) < 2 or len(np.unique(ratings.rating)) < 2:
        raise UserError("The ordinal model needs ratings of two conditions and of two levels.")
    # Levels that nobody used have no cutpoint.
    used, level = np.unique(ratings.rating, return_inverse=True)
    kernel = numpyro.infer.NUTS(
        _parted(ratings, numpyro), init_strategy=numpyro.infer.init_to_feasible, target_accept_prob=0.85
    )
    sampler = numpyro.infer.MCMC(
        kernel,
        num_warmup=config.warmup,
        num_samples=config.draws,
        num_chains=config.chains,
        chain_method="vectorized",
        progress_bar=False,
    )
    grasps = int(ratings.grasp.max()) + 1
    sizes = (len(ratings.objects), len(ratings.conditions), len(ratings.raters), grasps, len(used))
    indices = (ratings.object, ratings.condition, ratings.rater, ratings.grasp)
    sampler.run(jax.random.PRNGKey(seed), sizes, indices, level, extra_fields=("diverging",))
    drawn = {name: np.asarray(value) for name, value in sampler.get_samples(group_by_chain=True).items()}
    differences: dict[tuple[str, str | None], Estimate] = {}
    n = len(ratings)
    for k, condition in enumerate(ratings.conditions[1:]):
        by_object = drawn["difference"][:, :, k]
        differences[condition, None] = _posterior(by_object.mean(-1), n)
        for o, name in enumerate(ratings.objects):
            differences[condition, name] = _posterior(by_object[..., o], n)
    deviations = {name: _posterior(drawn[f"sd_{name}"], n) for name in ("rater", "rater_difference", "grasp")}
    shown = {"difference": drawn["difference"].mean(-1), **{name: drawn[f"sd_{name}"] for name in deviations}}
    diverging = int(np.asarray(sampler.get_extra_fields()["diverging"]).sum())
    return OrdinalFit(differences, deviations, _caution(shown, diverging, config, numpyro))


# So many ratings say as much about one effect as the deviation that effects are expected to have. The more ratings
# there are of each effect, the less is gained by sampling it apart from its deviation.
_PRIOR_RATINGS = {"rater": 5, "rater_difference": 30, "grasp": 10}


def _parted(ratings: Ratings, numpyro):
    """The model, with effects sampled apart from their deviations as far as few ratings tell of each."""
    grasps = len(np.unique(ratings.grasp))
    conditions, raters = len(ratings.conditions), len(ratings.raters)
    units = {"rater": raters, "rater_difference": raters * conditions, "grasp": grasps}
    share = {name: len(ratings) / n / (len(ratings) / n + _PRIOR_RATINGS[name]) for name, n in units.items()}
    reparam = numpyro.infer.reparam.LocScaleReparam
    return numpyro.handlers.reparam(_model, config={name: reparam(centered) for name, centered in share.items()})


def _model(sizes: tuple[int, ...], indices: tuple[np.ndarray, ...], level: np.ndarray) -> None:
    import jax.numpy as jnp
    import numpyro
    from numpyro import distributions as dist

    n_objects, n_conditions, n_raters, n_grasps, n_levels = sizes
    object_, condition, rater, grasp = indices
    sample = numpyro.sample
    cutpoints = sample(
        "cutpoints",
        dist.TransformedDistribution(
            dist.Normal(0.0, 3.0).expand([n_levels - 1]).to_event(1), dist.transforms.OrderedTransform()
        ),
    )
    deviation = {name: sample(f"sd_{name}", dist.HalfNormal(1.5)) for name in ("rater", "rater_difference", "grasp")}
    difference = sample("difference", dist.Normal(0.0, 2.5).expand([n_conditions - 1, n_objects]).to_event(2))
    effect = jnp.zeros((n_conditions, n_objects)).at[1:].set(difference)
    if n_objects > 1:
        effect = effect + sample("object", dist.ZeroSumNormal(2.5, event_shape=(n_objects,)))
    of_rater = sample("rater", dist.Normal(0.0, deviation["rater"]).expand([n_raters]).to_event(1))
    own = sample(
        "rater_difference",
        dist.Normal(0.0, deviation["rater_difference"]).expand([n_conditions - 1, n_raters]).to_event(2),
    )
    own = jnp.zeros((n_conditions, n_raters)).at[1:].set(own)
    of_grasp = sample("grasp", dist.Normal(0.0, deviation["grasp"]).expand([n_grasps]).to_event(1))
    eta = effect[condition, object_] + of_rater[rater] + own[condition, rater] + of_grasp[grasp]
    sample("rating", dist.OrderedLogistic(eta, cutpoints), obs=level)


def _posterior(drawn: np.ndarray, n: int) -> Estimate:
    """Mean and draws of a parameter, (chains, draws)."""
    return Estimate(float(drawn.mean()), drawn.reshape(-1), n)


def _caution(drawn: dict[str, np.ndarray], diverging: int, config: ModelConfig, numpyro) -> str:
    parts = []
    if config.chains > 1:
        r_hat = max(float(np.max(numpyro.diagnostics.split_gelman_rubin(value))) for value in drawn.values())
        if not r_hat < _MAX_R_HAT:
            parts.append(f"R-hat is {r_hat:.2f}")
    if diverging > 0.01 * config.draws * config.chains:
        parts.append(f"{diverging} draws diverged")
    return f"The chains have not converged ({', '.join(parts)}): raise model.warmup." if parts else ""


def _required():
    try:
        import jax
        import numpyro
        import numpyro.diagnostics
        import numpyro.infer
        import numpyro.infer.reparam
    except ModuleNotFoundError:
        raise UserError(
            "The ordinal model needs NumPyro: pip install 'grabnet[study]'; or give model=null to do without."
        ) from None
    jax.config.update("jax_platforms", "cpu")
    return numpyro, jax
