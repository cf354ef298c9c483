"""A root in GRAB's layout without anything licensed: bodies that are two hands and nothing else pick up balls."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from hydra.utils import instantiate
from scipy.spatial.transform import Rotation

from grabnet.body.hand import OPEN_HANDS, HandModel, HandParameters
from grabnet.body.whole import BodyModel
from grabnet.cli.entry import compose
from grabnet.contact.sequences import annotate
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import Sequence, write_sequence
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.preprocess.run import preprocess
from tests.body.conftest import BODY_PARENTS
from tests.data.grab import random_sequence

RIGHT_WRIST, RIGHT_FINGERS, LEFT_WRIST, LEFT_FINGERS = 21, 40, 20, 25
# Where the left hand is, out of the way.
ASIDE = np.array([0, 0.5, 0], np.float32)
SEQUENCES = (
    "s1/apple_lift_1", "s1/ball_lift_1", "s1/ball_look_1", "s1/ball_pass_1", "s2/ball_lift_1", "s2/ball_use_1",
    "s2/mug_use_1",
)  # fmt: skip
N_FRAMES, RESTING = 10, 4  # frames, and of these before the ball is taken
STEP = 0.004  # metres that it rises in each further frame
TABLE_TOP = 0.8


def body_arrays() -> dict[str, np.ndarray]:
    """A body in SMPL-X's schema that consists of the open hands; they hang on the joints that SMPL-X's hang on."""
    right, left = HandModel.open("right"), HandModel.open("left")
    regressor, weights = np.zeros((55, 1556), np.float32), np.zeros((1556, 55), np.float32)
    regressor[:, :778] = right.J_regressor[0]  # all other joints lie where the right wrist does
    for hand, rows, wrist, fingers in (
        (right, slice(778), RIGHT_WRIST, RIGHT_FINGERS),
        (left, slice(778, None), LEFT_WRIST, LEFT_FINGERS),
    ):
        joints = [wrist, *range(fingers, fingers + 15)]
        regressor[joints] = 0
        regressor[joints, rows] = hand.J_regressor
        weights[rows, joints] = hand.weights
    return {
        "v_template": np.concatenate([right.v_template, left.v_template + ASIDE]),
        "shapedirs": np.zeros((1556, 3, 20)),
        "posedirs": np.zeros((1556, 3, 486)),
        "J_regressor": regressor,
        "weights": weights,
        "kintree_table": np.array([BODY_PARENTS, range(55)]),
        "f": np.concatenate([right.faces, left.faces + 778]),
        **{f"hands_components{side}": np.eye(45) for side in "lr"},
        **{f"hands_mean{side}": np.zeros(45) for side in "lr"},
    }


def grip() -> tuple[np.ndarray, float]:
    """Centre and radius of a ball into which thumb and index finger of the relaxed open hand reach by 1 mm."""
    hand = HandModel.open()
    relaxed = HandParameters(
        torch.eye(3)[None], axis_angle_to_matrix(hand.hands_mean.view(1, 15, 3)), torch.zeros(1, 3)
    )
    vertices = hand(relaxed).vertices[0].numpy()
    thumb, index = (vertices[hand.weights[:, joint].argmax()] for joint in (15, 3))
    return (thumb + index) / 2, float(np.linalg.norm(thumb - index)) / 2 + 0.001


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(4, grip()[1])


def lifting(name: str, lifted: bool = True) -> Sequence:
    """A ball rests on the table, then moves up with the hand that has taken it, turned anyhow; labels are missing."""
    subject, _, take = name.partition("/")
    rng = np.random.default_rng(sum(name.encode()))
    centre, radius = grip()
    hand = HandModel.open()
    wrist = hand.rest_joints(hand.v_template)[0].numpy()
    turn, ball_turn = Rotation.random(2, rng)
    shift = np.zeros((N_FRAMES, 3), np.float32)
    if lifted:
        shift[RESTING:, 2] = STEP * np.arange(1, N_FRAMES - RESTING + 1)
    thing = np.array([0.3, -0.2, TABLE_TOP + radius]) + shift
    away = np.where(np.arange(N_FRAMES) < RESTING, 0.3, 0.0)[:, None] * np.array([0, 0, 1])
    transl = (thing - turn.apply(centre - wrist) - wrist + away).astype(np.float32)
    made = random_sequence(N_FRAMES)

    def still(vector: np.ndarray) -> np.ndarray:
        return np.tile(np.asarray(vector, np.float32).reshape(1, -1), (N_FRAMES, 1))

    fullpose = np.zeros(165)
    fullpose[3 * RIGHT_WRIST : 3 * RIGHT_WRIST + 3] = turn.as_rotvec()
    fullpose[3 * RIGHT_FINGERS :] = hand.hands_mean
    template = f"tools/subject_meshes/female/{subject}"
    return replace(
        made,
        name=name,
        sbj_id=subject,
        obj_name=take.split("_")[0],
        motion_intent=take.split("_")[1],
        body=replace(
            made.body, transl=transl, fullpose=still(fullpose), expression=0 * made.body.expression,
            vtemp=f"{template}.ply",
        ),
        rhand=replace(
            made.rhand, global_orient=still(turn.as_rotvec()), fullpose=still(hand.hands_mean), transl=transl,
            vtemp=f"{template}_rhand.ply",
        ),
        lhand=replace(
            made.lhand, global_orient=still(np.zeros(3)), fullpose=still(np.zeros(45)), transl=transl + ASIDE,
            vtemp=f"{template}_lhand.ply",
        ),
        object=replace(
            made.object, transl=thing.astype(np.float32), global_orient=still(ball_turn.as_rotvec()),
            mesh=str(OBJECT_MESHES / f"{take.split('_')[0]}.ply"),
        ),
        table=replace(made.table, transl=still([0, 0, TABLE_TOP]), global_orient=still(np.zeros(3))),
    )  # fmt: skip


def write_grab(root: Path, models: Path) -> None:
    """Everything under `root` as GRAB has it, and under `models` the files that go with it."""
    for path, content in (
        (models / "smplx/SMPLX_FEMALE.npz", body_arrays()),
        (models / "smplx/SMPLX_MALE.npz", body_arrays()),
        *((models / f"MANO_{s}.npz", dict(np.load(OPEN_HANDS / f"MANO_{s}.npz"))) for s in ("RIGHT", "LEFT")),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, **content)
    body, solid = BodyModel(models / "smplx/SMPLX_FEMALE.npz"), ball()
    things = {name: Mesh(solid.vertices, solid.faces) for name in ("apple", "ball", "mug")}
    board = trimesh.creation.box((1, 1, 0.05))
    board.apply_translation([0, 0, -0.025])
    things["table"] = Mesh(board.vertices, board.faces)
    for name, mesh in things.items():
        save_mesh(root / OBJECT_MESHES / f"{name}.ply", mesh)
    for subject in ("s1", "s2"):
        folder = root / "tools/subject_meshes/female"
        save_mesh(folder / f"{subject}.ply", Mesh(body.v_template, body.faces))
        for side in ("right", "left"):
            hand = HandModel.open(side)
            save_mesh(folder / f"{subject}_{side[0]}hand.ply", Mesh(hand.v_template, hand.faces))
    for name in SEQUENCES:
        made = lifting(name, lifted="look" not in name)
        contact = annotate(made, body, body.v_template, things["ball"]).labels
        write_sequence(root / "grab" / f"{name}.npz", replace(made, contact=contact))


def overrides(root: Path, models: Path, output: Path, cache_dir: Path, *more: str) -> list[str]:
    """Values for `scripts/preprocess.py`."""
    return [
        "data=grab",
        f"data.root={root}",
        f"data.models={models}",
        f"output={output}",
        f"cache_dir={cache_dir}",
        "workers=1",
        "pictures=false",
        "filter.min_finger_vertices=1",
        *more,
    ]


def files_of(folder: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder, by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def make(grab: tuple[Path, Path], output: Path, cache_dir: Path, *more: str) -> dict[str, str | None]:
    """Run with these values; why recordings failed."""
    config = compose("preprocess/preprocess", overrides(*grab, output, cache_dir, *more))
    return {outcome.name: outcome.failure for outcome in preprocess(instantiate(config, _convert_="all"))}


def data_set(folder: Path) -> dict[str, bytes]:
    """Its files' bytes, without what tells of the run."""
    return {name: content for name, content in files_of(folder).items() if name != "run.json"}
