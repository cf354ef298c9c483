"""Command lines of training runs that take seconds."""

from __future__ import annotations

from pathlib import Path


def tiny_overrides(
    root: Path, run_dir: Path | None, cache_dir: Path, model: str = "coarsenet", *more: str
) -> list[str]:
    """Values for `train.py`: three epochs of three steps of a small network on the tiny data set.

    Args:
        root: of the data set.
        run_dir: None for a sweep, whose runs have folders of their own.
        more: further values.
    """
    return [
        f"model={model}",
        "data=frames",
        f"data.root={root}",
        f"data.cache_dir={cache_dir}",
        "data.split.val=[can]",
        "data.split.test=[ring]",
        "data.batch_size=32",
        "data.object_points=64",
        *([f"run_dir={run_dir}"] if run_dir else []),
        "model.width=32",
        "model.n_hidden=16",
        "trainer.max_epochs=3",
        "callbacks.progress_bar=null",
        *(["model.bps.n_points=128"] if model == "coarsenet" else []),
        *more,
    ]
