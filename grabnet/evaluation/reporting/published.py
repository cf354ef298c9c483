"""What others have reported, to stand beside: on other data and often by other protocols, so rough marks only (ref. 8,
9)."""

from __future__ import annotations

SOURCE = "GrabNet on GRAB, as published"

# By metric, network and split: mm per coordinate on GRAB; paper 4.
OF_NETWORKS = {
    "reconstruction/published_v2v_mae": {
        "CoarseNet": {"train": 12.1, "val": 14.1, "test": 18.4},
        "RefineNet": {"train": 3.7, "val": 4.1, "test": 4.4},
    },
}

# By metric and object: closest ground truth on GRAB; the paper, Table 2.
BY_OBJECT = {
    "table2/vertices": {
        "binoculars": 2.56,
        "camera": 2.90,
        "fryingpan": 3.58,
        "mug": 1.96,
        "toothpaste": 1.78,
        "wineglass": 1.92,
        "all": 2.45,
    },
    "table2/contact": {
        "binoculars": 4.00,
        "camera": 3.75,
        "fryingpan": 4.16,
        "mug": 3.25,
        "toothpaste": 5.39,
        "wineglass": 4.56,
        "all": 4.18,
    },
}

# By work and the metric that comes nearest to what it reports; as quoted in the papers that compare them.
_FIELD = ("halo/volume", "halo/contact", "grasptta/displacement", "diversity/cluster_size")
# All re-run by the authors of VolCo (NeurIPS 2026): networks trained on GRAB, on GRAB's test objects and on HO-3D's.
_VOLCO = (
    "volco/displacement",
    "volco/depth",
    "volco/volume",
    "volco/contact_area",
    "volco/entropy",
    "volco/cluster_size",
)


def _rows(titles: tuple[str, ...], works: dict[str, tuple[float | None, ...]]) -> dict[str, dict[str, float]]:
    return {
        work: {title: value for title, value in zip(titles, values, strict=False) if value is not None}
        for work, values in works.items()
    }


BY_OTHERS = _rows(
    _FIELD,
    {
        "GrabNet": (15.50, 99.0, 2.34, 2.06),
        "GraspTTA": (7.37, 76.0, 5.34, 1.43),
        "ContactGen": (9.96, 97.0, 2.70, 5.04),
        "NL2Contact": (5.89, 99.0, 2.31, 5.91),
        "DVQ-VAE": (3.18, 98.6, 2.13, None),
        "FastGrasp": (4.61, 94.0, 1.20, None),
        "AffordGrasp": (3.06, 94.0, 1.66, None),
    },
) | _rows(
    _VOLCO,
    {
        "GrabNet, by VolCo": (1.02, 0.40, 7.43, 25.5, 2.79, 2.57),
        "ContactGen, by VolCo": (2.32, 0.52, 3.32, 19.9, 2.76, 4.28),
        "FastGrasp, by VolCo": (2.55, 0.53, 2.02, 13.3, 2.77, 0.41),
        "FAGrasp, by VolCo": (0.61, 0.73, 4.74, 30.6, 2.65, 3.84),
        "VolCoDiff": (0.52, 0.27, 3.78, 31.1, 2.77, 3.61),
        "GrabNet, HO-3D objects, by VolCo": (1.61, 1.04, 8.30, 31.4),
        "VolCoDiff, HO-3D objects": (1.06, 0.70, 10.9, 45.4),
    },
)
