"""A folder of recordings in GRAB's layout, and the hand and body models that their poses are for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from grabnet.body.hand import OPEN_HANDS
from grabnet.body.whole import OPEN_BODY
from grabnet.data.objects import OBJECT_MESHES, object_files
from grabnet.errors import UserError
from grabnet.io.files import existing


@dataclass(frozen=True)
class Recordings:
    """Where the files of a data set are.

    Args:
        root: folder with `grab/<subject>/*.npz` and `tools/`.
        models: folder with MANO's and SMPL-X's files, in it or in its `mano` and `smplx`; the open hand and body when
            omitted.
    """

    root: str
    models: str | None

    @cached_property
    def folder(self) -> Path:
        """The root, from `/`."""
        return Path(self.root).resolve()

    def names(self) -> list[str]:
        """Of all recordings, `<subject>/<object>_<action>_<k>`.

        Raises:
            UserError: there are none.
        """
        names = [f"{file.parent.name}/{file.stem}" for file in sorted(self.folder.glob("grab/*/[!.]*.npz"))]
        if not names:
            remedy = "make them with python scripts/build_open.py sequences"
            if self.models is not None:
                remedy = "unpack GRAB with python scripts/unpack_grab.py and name its folder with grab.root="
            raise UserError(f"{self.folder} holds no recordings grab/<subject>/<sequence>.npz: {remedy}.")
        return names

    @cached_property
    def objects(self) -> dict[str, Path]:
        """Mesh file of each object."""
        return object_files(self.folder / OBJECT_MESHES)

    def hand(self, side: str) -> Path:
        """File of the `side`, right or left, hand model."""
        if self.models is None:
            return OPEN_HANDS / f"MANO_{side.upper()}.npz"
        return self._model("mano", f"MANO_{side.upper()}")

    def body(self, gender: str) -> Path:
        """File of the whole-body model of a gender; there is but one open body."""
        if self.models is None:
            return OPEN_BODY / "SMPLX_NEUTRAL.npz"
        return self._model("smplx", f"SMPLX_{gender.upper()}")

    def _model(self, folder: str, name: str) -> Path:
        root = existing(self.models, "Folder of models (models.root)").resolve()
        wanted = [root / place / f"{name}{suffix}" for place in ("", folder) for suffix in (".npz", ".pkl")]
        for path in wanted:
            if path.exists():
                return path
        raise UserError(f"{root} holds neither {name} nor {folder}/{name}, as .npz or .pkl: put that model there.")
