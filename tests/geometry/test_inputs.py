"""A box of 6 x 5 x 10 cm, or another where noted, in the dialects and with the faults of programs that people use."""

from pathlib import Path

import numpy as np
import pytest
import torch

from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.object_mesh import load_object
from grabnet.geometry.queries import MeshQuery
from tests.geometry.shapes import box_distance

INPUTS = Path(__file__).parent / "inputs"
# Of others than the box: sides and volume in cm.
OTHERS = {"blender_quads_and_tris.ply": ((5, 6, 7), 210), "sketchup_double_sided.obj": ((6, 5, 8), 240)}
REPAIRS = {
    "double_sided.obj": ("dropped 12 of 24 faces, which were there twice",),
    "sketchup_double_sided.obj": ("dropped 12 of 24 faces, which were there twice",),
    "double_partly.obj": ("dropped 6 of 18 faces, which were there twice",),
    "half_flipped.obj": ("turned 6 of 12 faces, which looked the wrong way",),
}
REFUSED = {
    "blender_comment_obj_named.ply": "it looks like .obj, rename it",
    "draco.glb": "requires the extension KHR_draco_mesh_compression, which is not read: export it without",
    "meshopt.glb": "requires the extension EXT_meshopt_compression, which is not read: export it without",
    "g_position_vec2.glb": "accessor 0 is of type VEC2 where VEC3 is due",
    "far_100000.obj": "1,044,031 times its size; more than 1,000 times .* move it to the origin",
    "far_1e+06.obj": "10,440,307 times its size",
}
READ = sorted(path.name for path in INPUTS.iterdir() if path.name not in REFUSED)


@pytest.mark.parametrize("name", READ)
def test_every_dialect_is_the_same_solid(name):
    """Volume, sides, and the side and distance of any point, as the box has them in closed form."""
    sides, volume = OTHERS.get(name, ((6, 5, 10), 300))
    placed = load_object(INPUTS / name, up="z")
    solid = placed.solid
    atol = 1e-6 if name == "quantised.glb" else 1e-8  # 16 bits
    np.testing.assert_allclose(solid.extents, np.array(sides) / 100, atol=max(4e-6, atol))
    assert solid.volume == pytest.approx(volume * 1e-6, rel=2e-4)
    assert solid.is_closed and len(solid.faces) == 12
    assert placed.remarks == REPAIRS.get(name, ())
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (2000, 3)).astype(np.float32)
    distance = MeshQuery(solid).signed_distance(torch.from_numpy(points + solid.bounds.mean(0)))
    np.testing.assert_allclose(distance, box_distance(points, tuple(np.array(sides) / 100)), atol=4e-6)


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_is_refused_by_name_and_remedy(name):
    with pytest.raises(UserError, match=REFUSED[name]) as error:
        load_object(INPUTS / name)
    assert name in str(error.value) and "\n" not in str(error.value)


def test_repairs_are_said_wherever_meshes_are_loaded():
    with pytest.warns(UserWarning, match="half_flipped.obj was mended: turned 6 of 12 faces"):
        load_mesh(INPUTS / "half_flipped.obj")
