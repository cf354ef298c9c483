"""Whether a recording is fit to be kept: smooth, feet still, nothing passes through anything."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import lru_cache

import numpy as np
import torch

from grabnet.body.skeleton import JOINTS, LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.data.sequences import Sequence
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.open.sequences.motion import Pose
from grabnet.open.sequences.performance import Performance
from grabnet.open.sequences.props import StageProp
from grabnet.open.sequences.setting import TABLE_SIZE, Table

_EVERY = 4  # frames from one to the next in which depths are measured
_BATCH = 64
_FEET = [JOINTS.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
_TRUNK = [JOINTS.index(j) for j in ("pelvis", "spine1", "spine2", "spine3")]
_HEAD = [JOINTS.index(j) for j in ("neck", "head", "jaw")]
_LOWER_ARMS = [JOINTS.index(f"{side}_elbow") for side in ("left", "right")]


@dataclass(frozen=True)
class RecordingMeasures:
    """Of a recording, at most over its frames; also the limits. Millimetres and degrees, per frame at 120 per second.

    step: of any vertex of body or object. turn: of any joint or the object. feet: how far a vertex of the feet gets
    from where it was. loose: motion of the object against the hand that holds it, or on the table when none does.
    off_table: height of the resting object over the table. hand_depth, body_depth: of hands and of the rest of the
    body in the object. table_depth: of the body in the table top. trunk_depth: of hands and forearms in trunk or head.
    """

    step: float = 20.0
    turn: float = 15.0
    feet: float = 1.0
    loose: float = 0.2
    off_table: float = 1.0
    hand_depth: float = 6.0
    body_depth: float = 4.0
    table_depth: float = 3.0
    trunk_depth: float = 8.0

    def beyond(self, limits: RecordingMeasures) -> list[str]:
        """Names of those that exceed their limits."""
        return [f.name for f in fields(self) if not getattr(self, f.name) <= getattr(limits, f.name)]

    def rounded(self) -> dict[str, float]:
        return {name: round(float(value), 2) for name, value in asdict(self).items()}


@torch.no_grad()
def measure(sequence: Sequence, stage: Performance, prop: StageProp, table: Table) -> RecordingMeasures:
    """Measure a recording on its surfaces."""
    actor = stage.actor
    part = actor.body.weights.argmax(1).numpy()
    in_hand = np.isin(part, [*RIGHT_HAND_JOINTS, *LEFT_HAND_JOINTS])
    feet, arms = torch.as_tensor(np.isin(part, _FEET)), in_hand | np.isin(part, _LOWER_ARMS)
    low, high = prop.mesh.bounds.astype(np.float64)
    rotation, transl = sequence.table.rotations(slice(0, 1))[0].double().numpy(), sequence.table.transl[0].astype(float)
    width, thickness, depth = TABLE_SIZE
    half = np.array([width, depth, thickness]) / 2

    trunk = actor.trunk(np.concatenate(stage.trunk))
    from_world = _to_body_frame(sequence, stage)
    trunk_mesh, head_mesh = _part_query(actor, tuple(_TRUNK)), _part_query(actor, tuple(_HEAD))
    spine3, head = actor.joints[JOINTS.index("spine3")], actor.joints[JOINTS.index("head")]

    step = feet_way = hand_depth = body_depth = table_depth = trunk_depth = 0.0
    first = last = None
    for start in range(0, len(sequence), _BATCH):
        frames = slice(start, start + _BATCH)
        posed = actor.body(sequence.body.parameters(frames), actor.v_template).vertices
        before = posed[:-1] if last is None else torch.cat([last[None], posed[:-1]])
        way = (posed[-len(before) :] - before).square_()
        step = max(step, float((way[..., 0] + way[..., 1] + way[..., 2]).max().sqrt()))
        first = posed[0] if first is None else first
        feet_way = max(feet_way, float((posed[:, feet] - first[feet]).abs().max()))
        last = posed[-1].clone()

        some = np.arange(-start % _EVERY, len(posed), _EVERY)
        local = sequence.object.to_local(posed[some], start + some).numpy()
        near = _inside_box(local, low, high)
        for mask, is_hand in ((near & in_hand, True), (near & ~in_hand, False)):
            if mask.any():
                depth = max(0.0, -float(prop.distance(local[mask]).min()))
                hand_depth, body_depth = (
                    (max(hand_depth, depth), body_depth) if is_hand else (hand_depth, max(body_depth, depth))
                )
        vertices = posed[some].numpy()
        across, along, up = np.moveaxis(np.abs((vertices - transl) @ rotation + [0, 0, half[2]]), -1, 0)
        inside = np.minimum(np.minimum(half[0] - across, half[1] - along), half[2] - up)
        table_depth = max(table_depth, float(inside.max()))
        skin = from_world.points(vertices[:, arms].reshape(-1, 3)).reshape(len(some), -1, 3)
        for query, at, origin in ((trunk_mesh, trunk.chest, spine3), (head_mesh, trunk.head, head)):
            frame = Pose(at.rotation[start + some], at.position[start + some]).inverse()
            points = skin @ np.swapaxes(frame.rotation, 1, 2) + frame.position[:, None] + origin
            distance = query.signed_distance(torch.as_tensor(points.reshape(-1, 3)).float(), 0.1)
            inside = -distance[torch.isfinite(distance)]
            trunk_depth = max(trunk_depth, float(inside.max()) if len(inside) else 0.0)

    corners = sequence.object.to_world(torch.as_tensor(prop.mesh.vertices[:: max(1, len(prop.vertices) // 500)].copy()))
    step = max(step, float(corners.diff(dim=0).norm(dim=-1).max()))
    height = prop.vertices @ sequence.object.rotations(slice(0, 1))[0].numpy().T[:, 2] + sequence.object.transl[0, 2]
    return RecordingMeasures(
        step=1e3 * step,
        turn=_fastest_turn(sequence),
        feet=1e3 * feet_way,
        loose=1e3 * _loose(sequence, stage),
        off_table=1e3 * abs(float(height.min()) - float(transl[2])),
        hand_depth=1e3 * hand_depth,
        body_depth=1e3 * body_depth,
        table_depth=1e3 * max(0.0, table_depth),
        trunk_depth=1e3 * max(0.0, trunk_depth),
    )


def _inside_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    x, y, z = (((points[..., k] > low[k]) & (points[..., k] < high[k])) for k in range(3))
    return x & y & z


def _fastest_turn(sequence: Sequence) -> float:
    """Degrees from frame to frame of any joint, or of the object."""
    body = sequence.body.parameters().rotations
    thing = sequence.object.rotations().unsqueeze(1)
    both = torch.cat([body, thing], 1)
    relative = both[:-1].mT @ both[1:]
    cosine = (relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).max())


def _loose(sequence: Sequence, stage: Performance) -> float:
    """Metres by which the object moves against what it should be fixed to."""
    held = np.array(stage.held)
    worst = 0.0
    thing = sequence.object.rotations().double().numpy(), sequence.object.transl.astype(np.float64)
    for by, track in (("right", sequence.rhand), ("left", sequence.lhand)):
        wrist = track.parameters().global_orient.double().numpy()
        origin = stage.actor.hand_wrist * (1 if by == "right" else (-1, 1, 1))
        inside = np.swapaxes(wrist, 1, 2) @ (thing[1] - track.transl - origin)[..., None]
        together = (held[1:] == by) & (held[:-1] == by)
        if together.any():
            worst = max(worst, np.linalg.norm(np.diff(inside[..., 0], axis=0), axis=1)[together].max())
    alone = (held[1:] == "") & (held[:-1] == "")
    return max(worst, np.linalg.norm(np.diff(thing[1], axis=0), axis=1)[alone].max())


def _to_body_frame(sequence: Sequence, stage: Performance) -> Pose:
    """From the world to the frame in which the plan was made."""
    trunk = stage.actor.trunk(np.concatenate(stage.trunk)[:1])
    world = sequence.body.parameters(slice(0, 1)).global_orient[0].double().numpy() @ trunk.rotations["pelvis"][0].T
    root = sequence.body.transl[0] + stage.actor.joints[0]
    return Pose(world, root - world @ (stage.actor.joints[0] + trunk.transl[0])).inverse()


@lru_cache(maxsize=8)
def _part_query(actor, joints: tuple[int, ...]) -> MeshQuery:
    """Distances to a part of the body at rest."""
    part = actor.body.weights.argmax(1).numpy()
    faces = actor.body.faces.numpy()
    faces = faces[np.isin(part, joints)[faces].all(1)]
    kept, numbered = np.unique(faces, return_inverse=True)
    return MeshQuery(Mesh(actor.subject.v_template[kept], numbered.reshape(-1, 3)))
