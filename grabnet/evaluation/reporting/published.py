"""What others have reported, to stand beside: on other data and often by other protocols, so rough marks only (ref. 8,
9)."""

# mm per coordinate (v2v_mae), train, val, test, on GRAB: paper 4.
RECONSTRUCTION = {"CoarseNet": (12.1, 14.1, 18.4), "RefineNet": (3.7, 4.1, 4.4)}

# Closest ground truth on GRAB: vertices in cm, contact in %; the paper, Table 2.
TABLE2 = {
    "binoculars": (2.56, 4.00),
    "camera": (2.90, 3.75),
    "fryingpan": (3.58, 4.16),
    "mug": (1.96, 3.25),
    "toothpaste": (1.78, 5.39),
    "wineglass": (1.92, 4.56),
    "all": (2.45, 4.18),
}

# Volume in cm³, contact in %, displacement in cm, cluster size in cm; as quoted in the papers that compare them.
FIELD = {
    "GrabNet": (15.50, 99.0, 2.34, 2.06),
    "GraspTTA": (7.37, 76.0, 5.34, 1.43),
    "ContactGen": (9.96, 97.0, 2.70, 5.04),
    "NL2Contact": (5.89, 99.0, 2.31, 5.91),
    "DVQ-VAE": (3.18, 98.6, 2.13, None),
    "FastGrasp": (4.61, 94.0, 1.20, None),
    "AffordGrasp": (3.06, 94.0, 1.66, None),
}
