"""Whose markers they are: the body and hand models, and the subject's own shape."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import torch
from torch import Tensor

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, read_mesh, save_mesh
from grabnet.io.files import existing, replacing

_TEMPLATES = Path("tools/subject_meshes")  # GRAB's own layout, below its root
_SIZES = (0.4, 2.0)  # of a person, by that of the model
SIDES = ("left", "right")
GENDERS = ("male", "female", "neutral")


@dataclass(frozen=True)
class Subject:
    """A person of a capture.

    Attributes:
        name: as in s1, which names the folder of the recordings.
        gender: whose model is used, and folder of the templates.
        template: file of the person's resting body, with the model's vertices; None where the shape is solved for.
            Hands are those of `<name>_rhand.ply` and `<name>_lhand.ply` beside it, or else of the models' mean shape.
        models: folder with MANO's and SMPL-X's files, in it or in its `mano` and `smplx`; the open ones when None.

    Raises:
        UserError: on first use: no such file, or one of another model.
    """

    name: str
    gender: str
    template: str | None
    models: str | None

    def __getstate__(self) -> dict[str, str | None]:
        """Without the models, which another process reads for itself."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def body(self) -> BodyModel:
        return BodyModel(self.files()["body"])

    @cached_property
    def v_template(self) -> Tensor:
        """(V, 3) the resting body; the model's own where no file gives it."""
        if self.template is None:
            return self.body.v_template
        file = existing(self.template, "Template of the subject")
        vertices = torch.tensor(read_mesh(file, weld=False, mend=False).vertices)
        if len(vertices) != len(self.body.v_template):
            raise UserError(
                f"{self.template} has {len(vertices):,} vertices, the body model {len(self.body.v_template):,}: they "
                "must be of one kind."
            )
        size, usual = (float(x.double().std(0).norm()) for x in (vertices, self.body.v_template))
        if not _SIZES[0] <= size / usual <= _SIZES[1]:
            raise UserError(
                f"{self.template} is {size / usual:.3g} times as large as the body model: it must be in metres."
            )
        return vertices

    def hand(self, side: str) -> HandModel:
        """The hand model of a side."""
        return HandModel(self.files()[f"{side}_hand"])

    def files(self) -> dict[str, Path]:
        """All that decides body and hands, by what it is."""
        hands = {side: f"MANO_{side.upper()}" for side in SIDES}
        if self.models is None:
            found = {"body": OPEN_BODY / "SMPLX_NEUTRAL.npz"}
            found |= {f"{side}_hand": OPEN_HANDS / f"{name}.npz" for side, name in hands.items()}
        else:
            found = {"body": self._file("smplx", f"SMPLX_{self.gender.upper()}")}
            found |= {f"{side}_hand": self._file("mano", name) for side, name in hands.items()}
        parts = {
            "template": self._beside(""),
            **{f"{side}_template": self._beside(f"_{side[0]}hand") for side in SIDES},
        }
        return found | {part: path for part, path in parts.items() if path is not None}

    def path(self, part: str = "") -> str:
        """Path of a template below the data set's root; part is "", "_rhand" or "_lhand"."""
        return str(_TEMPLATES / self.gender / f"{self.name}{part}.ply")

    def write(self, root: Path, v_template: Tensor) -> None:
        """Write body and hands where a data set in GRAB's layout keeps them."""
        save = {"": Mesh(v_template.numpy(), self.body.faces.numpy())}
        save |= {f"_{s[0]}hand": Mesh(self.hand(s).v_template.numpy(), self.hand(s).faces.numpy()) for s in SIDES}
        for part, mesh in save.items():
            path, own = root / self.path(part), self._beside(part)
            path.parent.mkdir(parents=True, exist_ok=True)
            if own is not None and part:
                with replacing(path) as temporary:
                    shutil.copyfile(own, temporary)
            else:
                save_mesh(path, mesh)

    def wrist_at_rest(self, side: str) -> Tensor:
        """(3,) where the wrist of the hand's template is, float64."""
        hand, own = self.hand(side), self._beside(f"_{side[0]}hand")
        rest = hand.v_template if own is None else torch.tensor(read_mesh(own, weld=False, mend=False).vertices)
        return hand.rest_joints(rest)[0].double()

    def _beside(self, part: str) -> Path | None:
        if self.template is None:
            return None
        path = Path(self.template)
        path = path.with_name(f"{path.stem}{part}{path.suffix}")
        return path if path.exists() else None

    def _file(self, folder: str, name: str) -> Path:
        root = existing(self.models, "Folder of models (models)")
        for path in (root / place / f"{name}{suffix}" for place in ("", folder) for suffix in (".npz", ".pkl")):
            if path.exists():
                return path
        raise UserError(f"{root} holds neither {name} nor {folder}/{name}, as .npz or .pkl: put that model there.")


def expression_directions(body: BodyModel) -> Tensor | None:
    """(V, 3, up to 10) directions of expression, up to the last that moves anything; None of a model without."""
    directions = body.shapedirs[..., body.n_betas : body.n_betas + 10]
    used = (directions.abs().amax((0, 1)) > 0).nonzero()
    return directions[..., : int(used.max()) + 1] if len(used) else None
