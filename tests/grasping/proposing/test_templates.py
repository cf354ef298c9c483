from __future__ import annotations

import torch

from grabnet.grasping.grasp_hand import GraspPose
from grabnet.grasping.proposing.templates import KINDS, regularity


def posed(hand, angles):
    return hand.posed(GraspPose(torch.eye(3).expand(len(angles), 3, 3), hand.joints[:1].expand(len(angles), 3), angles))


def test_precision_pads_are_an_aperture_apart_and_face_each_other(hand, anatomy, templates):
    tips = {"pinch": ["index3"], "tripod": ["index3", "middle3"]}
    tips["precision"] = [f"{finger}3" for finger in ("index", "middle", "ring", "pinky")]
    for kind, names in tips.items():
        template = templates[kind]
        vertices = posed(hand, template.angles).vertices
        thumb = vertices[:, anatomy.pads["thumb3"]].mean(1)
        fingers = torch.stack([vertices[:, anatomy.pads[name]].mean(1) for name in names]).mean(0)
        torch.testing.assert_close((fingers - thumb).norm(dim=1), template.aperture)
        wanted = torch.linspace(0.004, 0.10, len(template.aperture))
        assert (template.aperture - wanted).abs().max() < 0.004
        torch.testing.assert_close((thumb + fingers) / 2, template.centre)


def test_power_wraps_its_cylinder_without_cutting_it(hand, templates):
    template = templates["power"]
    offset = posed(hand, template.angles).vertices - template.centre.unsqueeze(1)
    axis = template.closing.unsqueeze(1)
    distance = (offset - (offset * axis).sum(-1, keepdim=True) * axis).norm(dim=-1) - template.aperture.unsqueeze(1) / 2
    usable = template.aperture > 0.03
    assert (distance.amin(1)[usable] > -0.006).all()
    assert ((distance[usable] < 0.004).sum(1) > 40).all()


def test_templates_stay_within_limits_and_axes_are_orthonormal(templates, limits):
    for kind in KINDS:
        template = templates[kind]
        assert (template.angles >= limits[:, 0] - 1e-5).all() and (template.angles <= limits[:, 1] + 1e-5).all()
        torch.testing.assert_close(template.closing.norm(dim=1), torch.ones(len(template.aperture)))
        assert (template.closing * template.approach).sum(1).abs().max() < 1e-5


def test_regularity_is_zero_for_fingers_bent_alike():
    angles = torch.tensor([0.5, 0.0, 0.8, 0.48] * 4 + [0.0] * 5)[None]
    for term in regularity(angles, 0.6):
        torch.testing.assert_close(term, torch.zeros(1), atol=1e-9, rtol=0)
    crooked = angles.clone()
    crooked[0, 6] += 0.3  # the middle finger's PIP: its DIP no longer follows, nor do its neighbours
    coupling, _, neighbours = regularity(crooked, 0.6)
    torch.testing.assert_close(coupling, torch.tensor([(0.6 * 0.3) ** 2]))
    torch.testing.assert_close(neighbours, torch.tensor([2 * 0.3**2]))
