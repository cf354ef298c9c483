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
BY_OTHERS = {
    work: {title: value for title, value in zip(_FIELD, values, strict=True) if value is not None}
    for work, values in {
        "GrabNet": (15.50, 99.0, 2.34, 2.06),
        "GraspTTA": (7.37, 76.0, 5.34, 1.43),
        "ContactGen": (9.96, 97.0, 2.70, 5.04),
        "NL2Contact": (5.89, 99.0, 2.31, 5.91),
        "DVQ-VAE": (3.18, 98.6, 2.13, None),
        "FastGrasp": (4.61, 94.0, 1.20, None),
        "AffordGrasp": (3.06, 94.0, 1.66, None),
    }.items()
}
