"""Where a subject's markers really sit, found once from some of the subject's captures (Stage I) and kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.body.skeleton import JOINTS
from grabnet.cli.ends import note
from grabnet.errors import UserError
from grabnet.io.files import replacing, sha256
from grabnet.io.npz import read_npz
from grabnet.mosh.attachment import Pose
from grabnet.mosh.choosing import choose_frames
from grabnet.mosh.doubting import undoubted
from grabnet.mosh.layouts import Layout, read_layout, write_layout
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.placing import marker_positions
from grabnet.mosh.priors import PriorConfig
from grabnet.mosh.reading import Reading
from grabnet.mosh.stage_one import StageOneConfig, stage_one
from grabnet.mosh.subjects import Subject, expression_directions

_LIMBS = ("left_knee", "right_knee", "left_elbow", "right_elbow", "neck")
_TRUNK_JOINTS = (0, 3, 6, 9)
_FRAMES = 4000  # looked at in each capture, evenly spread, which bounds memory
_UPRIGHT = 0.5  # cosine between pelvis and vertical: below it a body leans more than 60 degrees


@dataclass(frozen=True)
class Placement:
    """Where a subject's markers sit, as Stage I found it. layout, latent (M, 3), v_template (V, 3): as `StageOne`."""

    layout: Layout
    latent: Tensor
    v_template: Tensor

    @classmethod
    def load(cls, path: Path) -> Placement:
        """Read what `save` wrote; path is without suffix."""
        stored = read_npz(Path(f"{path}.npz"))
        if str(stored["layout_sha256"]) != sha256(Path(f"{path}.yaml")):
            raise UserError(f"{path}.yaml is not as it was when {path}.npz was written: restore it, or delete both.")
        layout = read_layout(f"{path}.yaml", len(stored["v_template"]))
        return cls(layout, torch.as_tensor(stored["latent"]), torch.as_tensor(stored["v_template"]))

    def save(self, path: Path) -> None:
        """Write `.yaml`, the layout, and last `.npz`, all else; path is without suffix."""
        write_layout(f"{path}.yaml", self.layout)
        with replacing(Path(f"{path}.npz")) as temporary:
            np.savez(temporary, latent=self.latent.numpy(), v_template=self.v_template.numpy(),
                     labels=np.array(self.layout.labels),
                     layout_sha256=np.array(sha256(Path(f"{path}.yaml"))))  # fmt: skip


def find_placement(
    subject: Subject,
    layout: Layout,
    files: Sequence[Path],
    reading: Reading,
    n_captures: int,
    config: StageOneConfig,
    prior: PriorConfig,
) -> Placement:
    """Solve Stage I, and say how good it is.

    Args:
        subject: whose captures they are.
        layout: about where the markers sit.
        files: the captures; damaged ones are passed over.
        reading: how they are read.
        n_captures: from which frames are taken, spread over the files.
        config: of Stage I.
        prior: of poses.

    Raises:
        UserError: no capture can be read; none shows the subject well enough; labels that don't fit the layout.
    """
    own = _readable(files, reading, layout, n_captures)
    there = {label for markers in own.values() for label in markers.labels}
    where = next(iter(own)) if len(own) == 1 else files[0].parent
    layout, notes = layout.restricted(sorted(there), where)
    for remark in notes:
        note(remark)
    if bare := _bare_limbs(subject, layout):
        print(f"No marker sits beyond {', '.join(bare)}: how the body is bent there is guessed.")
    positions = np.concatenate([markers.pick(layout.labels).positions[:: _thin(markers)] for markers in own.values()])
    positions = undoubted(torch.as_tensor(positions), config.doubt).numpy()
    body, template = subject.body, subject.v_template
    normals = vertex_normals(template.double(), body.faces).numpy()
    resting = marker_positions(layout, template.double().numpy(), normals)
    corner = [marker.vertices[0] for marker in layout.markers]
    trunk = body.weights[corner][:, _TRUNK_JOINTS].sum(1).numpy() > 0.6
    frames = choose_frames(positions, resting, trunk, config.frames, where)
    seen = np.isfinite(positions[frames][..., 0])
    if not (shown := seen.any(0)).all():
        lost = [label for label, there in zip(layout.labels, shown, strict=True) if not there]
        note(f"{', '.join(lost)}: in none of Stage I's frames, so where the layout has it.")
    directions = None if config.betas else expression_directions(body)
    found = stage_one(body, template, layout, positions[frames], config, prior, directions)
    typical = float(found.residuals.nanmedian())
    note(f"Stage I: {len(frames)} frames; markers {1e3 * typical:.2f} mm (median) from where the body has them.")
    if question := _lying(found.poses):
        note(question)
    return Placement(found.layout, found.latent, found.v_template)


def _bare_limbs(subject: Subject, layout: Layout) -> list[str]:
    """Of knees, elbows and neck those beyond which the skin carries no marker."""
    body = subject.body
    owners = {int(body.weights[marker.vertices[0]].argmax()) for marker in layout.markers}
    marked = set()
    for joint in owners:
        while joint >= 0:
            marked.add(joint)
            joint = int(body.parents[joint])
    return [name for name in _LIMBS if JOINTS.index(name) not in marked]


def _readable(files: Sequence[Path], reading: Reading, layout: Layout, n: int) -> dict[Path, MarkerData]:
    """The subject's markers of up to n captures, spread over those that can be read."""
    step = max(1, len(files) // n)
    order = [path for start in range(step) for path in files[start::step]]
    found: dict[Path, MarkerData] = {}
    first = None
    for path in order:
        if len(found) == n:
            break
        try:
            found[path] = reading.of_subject(path, reading.read(path), layout)
        except UserError as error:  # of what is wrong with a capture the run speaks when it comes to solve it
            first = first or error
    if not found:
        raise first
    return found


def _thin(markers: MarkerData) -> int:
    return max(1, -(-len(markers) // _FRAMES))


def _lying(poses: Pose) -> str | None:
    """A question, where the body lies along one of the world's level axes in most frames: another may be up."""
    up = poses.rotations[:, 0, :, 1].median(0).values
    axis = int(up.abs().argmax())
    if axis == 2 and up[2] > _UPRIGHT:
        return None
    if up[axis].abs() < _UPRIGHT or axis == 2:
        return "The subject is upside down or bent over in most frames: is reading.up the file's vertical axis?"
    return f"The subject lies along the file's axis {'xyz'[axis]} in most frames: if that is up, give reading.up."
