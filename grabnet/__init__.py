"""GrabNet: human grasps of unseen objects (Taheri et al., ECCV 2020)."""
