"""glTF: accessors of every kind, transforms, and what is refused by name."""

import base64
import json
import struct

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.geometry.formats.geometry import FormatError
from grabnet.geometry.formats.gltf import read

BOX = trimesh.creation.box((0.06, 0.05, 0.1))
POINTS, CORNERS = np.asarray(BOX.vertices, np.float32), np.asarray(BOX.faces).ravel()
KINDS = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}


class Document(dict):
    """A file of one mesh, written value by value."""

    def __init__(self, points=POINTS, corners=CORNERS, **node):
        self.data = b""
        super().__init__(
            asset={"version": "2.0"}, scene=0, scenes=[{"nodes": [0]}], nodes=[{"mesh": 0} | node],
            meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], accessors=[], bufferViews=[],
        )  # fmt: skip
        self.add(points)
        self.add(corners, "I", "SCALAR")

    def add(self, values, code="f", kind="VEC3", stride=0, normalized=False) -> dict:
        rows = np.asarray(values).reshape(len(values), -1).astype(np.dtype(code))
        data = b"".join(row.tobytes().ljust(stride, b"\xee") for row in rows)
        offset = len(self.data)
        self.data += data + b"\xee" * (-len(data) % 4)
        self["bufferViews"].append({"buffer": 0, "byteOffset": offset, "byteLength": len(data)})
        if stride:
            self["bufferViews"][-1]["byteStride"] = stride
        accessor = {"bufferView": len(self["bufferViews"]) - 1, "componentType": KINDS[code], "count": len(rows)}
        self["accessors"].append(accessor | {"type": kind, "normalized": normalized})
        return self["accessors"][-1]

    @property
    def primitive(self) -> dict:
        return self["meshes"][0]["primitives"][0]

    def glb(self) -> bytes:
        self.setdefault("buffers", [{"byteLength": len(self.data)}])
        text = json.dumps(self).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(self.data), b"BIN\0")
        return b"glTF" + struct.pack("<II", 2, 12 + len(chunks) + len(self.data)) + chunks + self.data


def never(uri):
    raise AssertionError(uri)


def solid(document, fetch=never) -> trimesh.Trimesh:
    return trimesh.Trimesh(*read(document.glb() if isinstance(document, Document) else document, fetch), process=False)


def assert_box(document, fetch=never):
    found = solid(document, fetch)
    np.testing.assert_allclose(found.triangles, BOX.triangles, atol=1e-7)


def test_glb_data_uris_and_files_hold_the_same():
    assert_box(Document())
    document = Document()
    for uri in ("data:application/octet-stream;base64,", "data:;base64,", "DATA:;BASE64,"):
        document["buffers"] = [
            {"byteLength": len(document.data), "uri": uri + base64.b64encode(document.data).decode()}
        ]
        assert_box(b"\xef\xbb\xbf" + json.dumps(document).encode())
    document["buffers"][0]["uri"] = "data:," + "".join(f"%{byte:02x}" for byte in document.data)
    assert_box(json.dumps(document).encode())
    document["buffers"][0]["uri"] = "a%20b.bin"
    assert_box(json.dumps(document).encode(), {"a%20b.bin": document.data}.__getitem__)


def test_positions_far_apart_in_the_buffer():
    document = Document()
    document.add(POINTS, stride=28)
    document.primitive["attributes"]["POSITION"] = 2
    assert_box(document)


@pytest.mark.parametrize(("code", "most"), [("b", 127), ("B", 255), ("h", 32767), ("H", 65535)])
def test_quantised_positions(code, most):
    """As KHR_mesh_quantization has them: scaled to -1 … 1 or 0 … 1, and as they are."""
    document = Document(scale=[0.1] * 3, translation=[0, 0, 0] if code in "bh" else [-0.05] * 3)
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    share = POINTS / 0.1 if code in "bh" else POINTS / 0.1 + 0.5
    whole = np.clip(np.round(share * most), -most - 1, most)
    document.add(whole, code, stride=8, normalized=True)
    document.primitive["attributes"]["POSITION"] = 2
    np.testing.assert_allclose(solid(document).triangles, BOX.triangles, atol=0.1 / most)
    document["accessors"][2]["normalized"] = False
    document["nodes"][0]["scale"] = [0.1 / most] * 3
    np.testing.assert_allclose(solid(document).triangles, BOX.triangles, atol=0.1 / most)


@pytest.mark.parametrize("stored", [True, False])
def test_sparse_accessors(stored):
    """Some values in place of others, or of zeros."""
    document = Document(POINTS * [[1], [2], [1], [3], [1], [1], [1], [4]])
    rows = [1, 3, 7] if stored else list(range(8))
    document.add(rows, "B", "SCALAR")
    document.add(POINTS[rows])
    for accessor in document["accessors"][2:]:
        accessor["byteOffset"] = 0
    indices, values = document["accessors"][2:]
    document["accessors"][0]["sparse"] = {"count": len(rows), "indices": indices, "values": values}
    if not stored:
        del document["accessors"][0]["bufferView"]
    assert_box(document)
    document["accessors"][0]["sparse"]["count"] = 9
    with pytest.raises(FormatError, match="reaches beyond its data"):
        solid(document)


def test_strips_fans_and_faces_without_numbers():
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    document = Document(square, [0, 1, 2, 3])
    document.primitive["mode"] = 5
    assert solid(document).faces.tolist() == [[0, 1, 2], [2, 1, 3]]
    document.primitive["mode"] = 6
    assert {tuple(sorted(face)) for face in solid(document).faces.tolist()} == {(0, 1, 2), (0, 2, 3)}
    document = Document(square[:3])
    del document.primitive["indices"]
    assert solid(document).faces.tolist() == [[0, 1, 2]]
    document.primitive["mode"] = 1
    assert len(solid(document).faces) == 0


def test_transforms_are_as_their_matrices():
    turn = Rotation.from_euler("xyz", [0.3, -1, 2])
    scale, shift = np.array([0.5, 2, 3]), np.array([1, 2, 3])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn.as_matrix() * scale, shift
    expected = BOX.copy().apply_transform(matrix).triangles
    document = Document(rotation=(2 * turn.as_quat()).tolist(), scale=scale.tolist(), translation=shift.tolist())
    np.testing.assert_allclose(solid(document).triangles, expected, atol=1e-6)
    document["nodes"] = [{"children": [1], "translation": [1, 2, 3]}, {"mesh": 0}]
    matrix[:3, 3] = 0
    document["nodes"][1]["matrix"] = matrix.T.ravel().tolist()
    np.testing.assert_allclose(solid(document).triangles, expected, atol=1e-6)
    # Without scenes all roots are shown; what no scene shows is not.
    del document["scenes"], document["scene"]
    np.testing.assert_allclose(solid(document).triangles, expected, atol=1e-6)
    document["scenes"] = [{"nodes": []}, {"nodes": [0]}]
    assert len(solid(document).faces) == 0


@pytest.mark.parametrize("scale", [[-1, 1, 1], [-2, -1, -1], [-1, -1, 1]])
def test_a_mirror_image_keeps_its_outside(scale):
    assert solid(Document(scale=scale)).volume > 0


def test_draco_with_data_beside_it_is_read():
    document = Document()
    document["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    document.primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    assert_box(document)
    view = document["accessors"][1].pop("bufferView")
    with pytest.raises(FormatError, match="compressed with KHR_draco_mesh_compression, which is not read"):
        solid(document)
    document["accessors"][1]["bufferView"] = view
    del document["accessors"][0]["bufferView"]
    with pytest.raises(FormatError, match="compressed with KHR_draco_mesh_compression, which is not read"):
        solid(document)


def test_meshopt_without_data_beside_it_is_refused_by_name():
    document = Document()
    document["bufferViews"][0] |= {"buffer": 1, "extensions": {"EXT_meshopt_compression": {}}}
    document["buffers"] = [{"byteLength": len(document.data)}, {"byteLength": 96}]
    with pytest.raises(FormatError, match="compressed with EXT_meshopt_compression, which is not read"):
        solid(document)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"extensionsRequired": ["ACME_secret_geometry"]}, "requires the extension ACME_secret_geometry"),
        ({"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "uses the extension EXT_mesh_gpu_instancing"),
        ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "extension EXT_mesh_gpu_instancing"),
        ({"nodes": [{"mesh": 0, "extensions": [1]}]}, "the extensions of node 0 are damaged"),
        ({"nodes": [{"extensions": {"KHR_node_visibility": {"visible": 0}}}]}, "the visibility of node 0 is damaged"),
        ({"asset": {"version": "2.0", "minVersion": "2.1"}}, "only as glTF 2.1 or later: export it as glTF 2.0"),
        ({"extensionsRequired": "x"}, "its extensionsRequired are no list"),
        ({"asset": {"version": "1.0"}}, "it is glTF 1.0, not 2.0"),
        ({"meshes": {"a": {}}}, "it is glTF 1: export it as glTF 2.0"),
        ({"meshes": []}, "refers to number 0 of its 0 meshes"),
        ({"nodes": [{"mesh": 0, "scale": [1, 1, float("nan")]}]}, "the scale of node 0 is not 3 finite numbers"),
        ({"nodes": [{"mesh": 0, "matrix": [float("nan")] * 16}]}, "the matrix of node 0 is not 16 finite numbers"),
        ({"nodes": [{"mesh": 0, "matrix": [1] * 15}]}, "the matrix of node 0 is not 16"),
        ({"nodes": [{"mesh": 0, "matrix": [1] * 16}]}, "is a projection"),
        ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}, "the rotation of node 0 is zero"),
        ({"nodes": [{"mesh": 0, "translation": [0, 0, 10**400]}]}, "the translation of node 0 is not 3"),
        ({"nodes": [{"children": [0]}]}, "node 0 is below two others, or below itself"),
        ({"nodes": [{"children": [1, 1]}, {}]}, "node 1 is below two others"),
        ({"nodes": [{"mesh": 0, "skin": 0}]}, "node 0 is moved by a skeleton"),
        ({"nodes": [{"mesh": True}]}, "a number of meshes is True"),
        ({"scene": -1}, "a number of scenes is -1"),
        ({"scene": 3}, "refers to number 3 of its 1 scenes"),
        ({"bufferViews": []}, "refers to number 0 of its 0 bufferViews"),
        ({"buffers": [{"byteLength": 10**6}]}, "buffer 0 ends before its 1000000 bytes"),
        ({"buffers": [{"byteLength": 4, "uri": 3}]}, "a URI that is no text"),
        ({"buffers": [{"byteLength": 4, "uri": "data:;base64,!!"}]}, "damaged base64"),
        ({"buffers": []}, "refers to buffer 0, which has no data"),
    ],
)
def test_what_is_not_read_is_refused(change, said):
    document = Document()
    document.update(change)
    with pytest.raises(FormatError, match=said):
        solid(document)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"type": "VEC2"}, "accessor 0 is of type VEC2 where VEC3 is due"),
        ({"count": 10**12}, "more than are read"),
        ({"count": 9}, "reaches beyond its data"),
        ({"count": -1}, "the count of accessor 0 is -1"),
        ({"count": None}, "the count of accessor 0 is None"),
        ({"byteOffset": 4}, "reaches beyond its data"),
        ({"componentType": 5130}, "unknown kind 5130"),
        ({"count": 7}, "names? vertices beyond its 7"),
        ({"sparse": []}, "sparse values that are damaged"),
    ],
)
def test_damaged_accessors_are_refused(change, said):
    document = Document()
    document["accessors"][0] |= change
    with pytest.raises(FormatError, match=said):
        solid(document)


def test_morph_targets_are_refused_where_they_change_the_shape():
    document = Document()
    document.primitive["targets"] = [{"POSITION": 0}]
    assert_box(document)
    document["meshes"][0]["weights"] = [0.5]
    with pytest.raises(FormatError, match="changed by morph targets"):
        solid(document)
    document["nodes"][0]["weights"] = [0]  # goes before the mesh's
    assert_box(document)
    document["nodes"][0]["weights"], document["meshes"][0]["weights"] = [1], [0]
    with pytest.raises(FormatError, match="mesh 0 is changed by morph targets"):
        solid(document)


def test_what_is_hidden_is_left_out_with_all_below_it():
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    document = Document(children=[1])
    document["extensionsRequired"] = ["KHR_node_visibility"]
    document["nodes"] += [{"children": [2]} | hidden, {"mesh": 0}]
    assert_box(document)
    document["nodes"][1]["extensions"]["KHR_node_visibility"] = {}
    assert len(solid(document).faces) == 24


def test_many_shown_copies_are_bounded():
    document = Document(np.zeros((3, 3)), np.tile([0, 1, 2], 300_000))
    document["nodes"] = [{"mesh": 0} for _ in range(10)]
    document["scenes"] = [{"nodes": list(range(10))}]
    with pytest.raises(FormatError, match="shows more than 2,000,000 faces: simplify"):
        solid(document)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"glTF" + struct.pack("<II", 1, 12), "it is glTF 1: export"),
        (Document().glb()[:-1], "ends within a chunk"),
        (b"glTF" + struct.pack("<II", 2, 12), "no JSON chunk"),
        (b"{", "its JSON is damaged"),
        (b"[" * 100_000, "its JSON is damaged"),
        (b"[]", "its JSON is no object"),
    ],
)
def test_broken_containers(data, said):
    with pytest.raises(FormatError, match=said):
        solid(data)
