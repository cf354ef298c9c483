"""Published checkpoints: exactly their names, and the numbers that their formulas give."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import smplx
import torch
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grabnet.body.hand import OPEN_HANDS, HandParameters
from grabnet.cli.entry import CONFIGS
from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.rotations import random_rotations
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.weights import load_network, read_conventions

SCRIPT = CONFIGS.parent / "scripts" / "import_checkpoint.py"
# Small, but each size its own, so that none can stand for another.
N_BPS, WIDTH, HIDDEN, LATENT, N_VERTICES = 40, 24, 10, 6, 778


def published(layers: dict[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    """A state dict of random layers: (features,) for a batch norm, (in, out) linear, (in, out, hidden) a block."""
    generator = torch.Generator().manual_seed(0)
    state = {}

    def add(name: str, *sizes: int) -> None:
        def random(*shape: int) -> torch.Tensor:
            return torch.randn(shape, generator=generator, dtype=torch.float32) * 0.3

        if len(sizes) == 1:
            state[f"{name}.weight"], state[f"{name}.bias"] = 1 + random(*sizes), random(*sizes)
            state[f"{name}.running_mean"], state[f"{name}.running_var"] = random(*sizes), 1 + random(*sizes).abs()
            state[f"{name}.num_batches_tracked"] = torch.tensor(1000)
        elif len(sizes) == 2:
            state[f"{name}.weight"], state[f"{name}.bias"] = random(sizes[1], sizes[0]), random(sizes[1])
        else:
            n_in, n_out, hidden = sizes
            for part, size in {"fc1": (n_in, hidden), "bn1": (hidden,), "fc2": (hidden, n_out), "bn2": (n_out,),
                               "fc3": (n_in, n_out)}.items():  # fmt: skip
                add(f"{name}.{part}", *size)

    for name, sizes in layers.items():
        add(name, *sizes)
    return state


def coarsenet_state() -> dict[str, torch.Tensor]:
    n_encoder, n_decoder = N_BPS + 12, N_BPS + LATENT
    return published(
        {
            "enc_bn0": (N_BPS,), "enc_bn1": (n_encoder,), "enc_rb1": (n_encoder, WIDTH, HIDDEN),
            "enc_rb2": (n_encoder + WIDTH, WIDTH, HIDDEN), "enc_mu": (WIDTH, LATENT), "enc_var": (WIDTH, LATENT),
            "dec_bn1": (N_BPS,), "dec_rb1": (n_decoder, WIDTH, HIDDEN), "dec_rb2": (n_decoder + WIDTH, WIDTH, HIDDEN),
            "dec_pose": (WIDTH, 96), "dec_trans": (WIDTH, 3),
        }
    )  # fmt: skip


def refinenet_state() -> dict[str, torch.Tensor]:
    n_in = N_VERTICES + 99
    blocks = {"rb1": (n_in, WIDTH, HIDDEN)} | {f"rb{k}": (n_in + WIDTH, WIDTH, HIDDEN) for k in (2, 3)}
    state = published({"bn1": (N_VERTICES,), **blocks, "out_p": (WIDTH, 96), "out_t": (WIDTH, 3)})
    return state | {"rhm_train.v_template": torch.zeros(778, 3), "rhm_train.lbs_weights": torch.zeros(778, 16)}


class Formulas:
    """The networks in eval mode as ref. 6 writes them, on plain tensors of the published names."""

    def __init__(self, state: dict[str, torch.Tensor]):
        self.state = {k: v.double() for k, v in state.items()}

    def linear(self, x, name):
        return x @ self.state[f"{name}.weight"].T + self.state[f"{name}.bias"]

    def norm(self, x, name):
        s = self.state
        scaled = (x - s[f"{name}.running_mean"]) / (s[f"{name}.running_var"] + 1e-5).sqrt()
        return scaled * s[f"{name}.weight"] + s[f"{name}.bias"]

    def block(self, x, name):
        y = self.lrelu(self.norm(self.linear(x, f"{name}.fc1"), f"{name}.bn1"))
        y = self.norm(self.linear(y, f"{name}.fc2"), f"{name}.bn2")
        return self.lrelu(self.lrelu(self.linear(x, f"{name}.fc3")) + y)

    @staticmethod
    def lrelu(x):
        return torch.maximum(x, 0.2 * x)

    @staticmethod
    def rotations(six_d):
        """(B, 96) → (B, 16, 3, 3) by Gram–Schmidt, joint by joint."""
        result = torch.zeros(len(six_d), 16, 3, 3, dtype=torch.float64)
        for b, j in np.ndindex(len(six_d), 16):
            first, second = six_d[b, 6 * j : 6 * j + 6].view(3, 2).T
            x = first / first.norm()
            y = second - (x @ second) * x
            y = y / y.norm()
            result[b, j] = torch.stack([x, y, torch.linalg.cross(x, y)], 1)
        return result


def save(folder, state, name="network.pt"):
    torch.save(state, folder / name)
    return folder / name


def inputs(batch=5):
    generator = torch.Generator().manual_seed(1)
    bps = torch.rand(batch, N_BPS, generator=generator) * 0.2
    return bps, random_rotations(batch, generator), torch.randn(batch, 3, generator=generator) * 0.1


def test_coarsenet_gives_the_published_formulas_numbers(tmp_path):
    state = coarsenet_state()
    network, f = CoarseNet.from_published(save(tmp_path, state)), Formulas(state)
    assert not network.training
    bps, orient, transl = inputs()
    x0 = f.norm(torch.cat([bps.double(), orient.double().flatten(1), transl.double()], 1), "enc_bn1")
    h = f.block(torch.cat([x0, f.block(x0, "enc_rb1")], 1), "enc_rb2")
    posterior = network.encode(bps, orient, transl)
    torch.testing.assert_close(posterior.mean.double(), f.linear(h, "enc_mu"), atol=1e-4, rtol=1e-4)
    deviation = torch.log1p(f.linear(h, "enc_var").exp())
    torch.testing.assert_close(posterior.stddev.double(), deviation, atol=1e-4, rtol=1e-4)

    z = torch.randn(5, LATENT, generator=torch.Generator().manual_seed(2))
    d0 = torch.cat([z.double(), f.norm(bps.double(), "dec_bn1")], 1)
    h = f.block(torch.cat([d0, f.block(d0, "dec_rb1")], 1), "dec_rb2")
    hand = network.decode(z, bps)
    torch.testing.assert_close(hand.rotations.double(), f.rotations(f.linear(h, "dec_pose")), atol=1e-4, rtol=0)
    torch.testing.assert_close(hand.transl.double(), f.linear(h, "dec_trans"), atol=1e-4, rtol=1e-4)


def test_refinenet_gives_the_published_formulas_numbers(tmp_path, hand):
    state = refinenet_state()
    network, f = RefineNet.from_published(save(tmp_path, state), hand), Formulas(state)
    assert not network.training and network.iterations == 3
    generator = torch.Generator().manual_seed(3)
    start = HandParameters.from_rotations(
        random_rotations(4 * 16, generator).view(4, 16, 3, 3), torch.randn(4, 3, generator=generator) * 0.1
    )

    def distances(vertices):  # to a ball
        return vertices.norm(dim=-1) - 0.04

    pose = start.rotations[..., :2].flatten(1).double()
    transl, rotations = start.transl.double(), start.rotations
    for _ in range(3):
        posed = hand(HandParameters.from_rotations(rotations.float(), transl.float())).vertices
        x0 = torch.cat([f.norm(distances(posed).double(), "bn1"), pose, transl], 1)
        h = f.block(x0, "rb1")
        h = f.block(torch.cat([h, x0], 1), "rb2")
        h = f.block(torch.cat([h, x0], 1), "rb3")
        pose, transl = pose + f.linear(h, "out_p"), transl + f.linear(h, "out_t")
        rotations = f.rotations(pose)
    refined = network(start, distances)
    torch.testing.assert_close(refined.rotations.double(), rotations, atol=1e-3, rtol=0)
    torch.testing.assert_close(refined.transl.double(), transl, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda s: s.pop("enc_mu.weight"), "lacks enc_mu.weight"),
        (lambda s: s.pop("dec_rb2.bn1.running_var"), "it lacks dec_rb2.bn1.running_var"),
        (lambda s: s.update({"enc_rb3.fc1.weight": torch.zeros(2)}), "has the unknown enc_rb3.fc1.weight"),
        (lambda s: s.update({"dec_pose.bias": torch.zeros(90)}), r"dec_pose.bias \(90,\) for \(96,\)"),
        (
            lambda s: s.update({"dec_trans.bias": torch.zeros(4), "x.y": torch.zeros(1)}),
            "unknown x.y; .*dec_trans.bias",
        ),
    ],
)
def test_other_names_and_shapes_are_listed(tmp_path, change, sentence):
    state = coarsenet_state()
    change(state)
    with pytest.raises(UserError, match=sentence):
        CoarseNet.from_published(save(tmp_path, state))


def test_a_network_taken_for_the_other_is_told(tmp_path, hand):
    with pytest.raises(UserError, match=r"no published RefineNet: it lacks bn1\.bias, .*; it has the unknown dec_bn1"):
        RefineNet.from_published(save(tmp_path, coarsenet_state()), hand)


class Bomb:
    def __reduce__(self):
        return os.mkdir, (os.environ["BOMB"],)


def test_files_that_are_no_weights_are_told_and_run_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("BOMB", str(tmp_path / "crater"))
    (tmp_path / "noise.pt").write_bytes(b"noise")
    files = [tmp_path / "noise.pt", save(tmp_path, {"enc_mu.weight": Bomb()}, "bomb.pt")]
    for file in files:
        with pytest.raises(UserError, match=rf"{file.name} cannot be read"):
            CoarseNet.from_published(file)
    with pytest.raises(UserError, match=r"list\.pt is no state dict"):
        CoarseNet.from_published(save(tmp_path, [torch.zeros(3)], "list.pt"))
    assert not (tmp_path / "crater").exists()


def run(*arguments):
    return subprocess.run([sys.executable, SCRIPT, *map(str, arguments)], capture_output=True, text=True, check=False)


def test_imported_networks_are_loaded_as_our_own(tmp_path, hand):
    basis = np.random.default_rng(0).normal(size=(1, N_BPS, 3)).astype(np.float32)
    np.savez(tmp_path / "bps.npz", basis=basis)
    coarse, fine = save(tmp_path, coarsenet_state(), "coarsenet.pt"), save(tmp_path, refinenet_state(), "refinenet.pt")
    here = {name: tmp_path / "out" / name / "model.safetensors" for name in ("coarsenet", "refinenet")}
    done = run("coarsenet", coarse, "--bps", tmp_path / "bps.npz", "--output", here["coarsenet"])
    assert (done.returncode, done.stderr) == (0, "")
    run("refinenet", fine, "--hand-model", OPEN_HANDS / "MANO_RIGHT.npz", "--output", here["refinenet"])

    loaded = load_network(here["coarsenet"].parent, kind="CoarseNet")
    np.testing.assert_array_equal(loaded.bps.basis, basis[0])
    for ours, source in (
        (loaded, CoarseNet.from_published(coarse, tmp_path / "bps.npz")),
        (load_network(here["refinenet"], hand, "RefineNet"), RefineNet.from_published(fine, hand)),
    ):
        expected = source.state_dict()
        assert ours.state_dict().keys() == expected.keys()
        assert all(torch.equal(value, expected[name]) for name, value in ours.state_dict().items())


def test_the_script_refuses_in_one_sentence(tmp_path):
    np.savez(tmp_path / "bps.npz", basis=np.zeros((5, 2)))
    done = run("coarsenet", save(tmp_path, coarsenet_state()), "--bps", tmp_path / "bps.npz")
    assert done.returncode == 2
    assert done.stderr == f"error: {tmp_path / 'bps.npz'} holds no basis of points (P, 3).\n"


def uneven_mesh(path):
    """A box with a dense ball near one of its corners: the mean vertex lies far from the middle of the bounding box."""
    ball = trimesh.creation.icosphere(3, 0.015)
    ball.apply_translation((0.02, 0.015, 0.05))
    solid = trimesh.util.concatenate([trimesh.creation.box((0.05, 0.06, 0.1)), ball])
    solid.apply_translation((0.2, -0.1, 0.3))
    solid.export(path)
    return trimesh.load(path, process=False)


def points_in_use(mesh):
    """10,000 points as `Conventions.vertices_in_use` says they are chosen, about the middle of the bounding box."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    middle = (vertices.min(0) + vertices.max(0)) / 2
    while len(vertices) < 10_000:
        pairs = sorted({tuple(sorted((f[i], f[j]))) for f in faces.tolist() for i, j in ((0, 1), (1, 2), (2, 0))})
        number = {pair: len(vertices) + k for k, pair in enumerate(pairs)}
        vertices = np.concatenate([vertices, [(vertices[i] + vertices[j]) / 2 for i, j in pairs]])
        finer = []
        for a, b, c in faces.tolist():
            ab, bc, ca = (number[tuple(sorted(pair))] for pair in ((a, b), (b, c), (c, a)))
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.array(finer)
    return vertices[np.random.default_rng(0).permutation(len(vertices))[:10_000]] - middle, middle


def plausible(coarse, fine):
    """The same random networks, but of hands about an object of some centimetres, which distances correct by some."""
    palm_down = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    six_d = torch.stack([palm_down, *[torch.eye(3)] * 15])[..., :2].flatten()
    changes = [(coarse, "dec_pose", 0.1, six_d), (coarse, "dec_trans", 0.005, torch.tensor([0.02, 0.0, 0.02]))]
    changes += [(fine, "out_p", 0.02, torch.zeros(96)), (fine, "out_t", 0.002, torch.zeros(3))]
    for state, layer, size, bias in changes:
        state[f"{layer}.weight"], state[f"{layer}.bias"] = state[f"{layer}.weight"] * size, bias
    for state, layer, mean, deviation in ((coarse, "dec_bn1", 0.1, 0.05), (fine, "bn1", 0.05, 0.03)):
        state[f"{layer}.running_mean"] = torch.full_like(state[f"{layer}.running_mean"], mean)
        state[f"{layer}.running_var"] = torch.full_like(state[f"{layer}.running_var"], deviation**2)


def published_grasps(mesh, basis, coarse, fine, latent):
    """Vertices in the mesh's frame, wired as the published networks are in use (ref. 6), in plain torch and scipy."""
    points, middle = points_in_use(mesh)
    tree, c, r = cKDTree(points), Formulas(coarse), Formulas(fine)
    bps = torch.from_numpy(tree.query(basis)[0]).expand(len(latent), -1)
    d0 = torch.cat([latent, c.norm(bps, "dec_bn1")], 1)
    h = c.block(torch.cat([d0, c.block(d0, "dec_rb1")], 1), "dec_rb2")
    rotations, transl = c.rotations(c.linear(h, "dec_pose")), c.linear(h, "dec_trans")
    file = OPEN_HANDS / "MANO_RIGHT.npz"
    with contextlib.redirect_stdout(io.StringIO()):  # smplx prints about betas
        mano = smplx.create(str(file), "mano", ext="npz", is_rhand=True, use_pca=False, flat_hand_mean=True,
                            dtype=torch.float64)  # fmt: skip

    def posed(rotations, transl):
        turns = Rotation.from_matrix(rotations.reshape(-1, 3, 3).numpy()).as_rotvec().reshape(-1, 48)
        turns = torch.from_numpy(turns)
        betas = torch.zeros(len(turns), 10, dtype=torch.float64)
        return mano(global_orient=turns[:, :3], hand_pose=turns[:, 3:], transl=transl, betas=betas).vertices

    pose = rotations[..., :2].flatten(1)
    for _ in range(3):
        distances = torch.from_numpy(tree.query(posed(rotations, transl).detach().numpy())[0])
        x0 = torch.cat([r.norm(distances, "bn1"), pose, transl], 1)
        h = r.block(x0, "rb1")
        h = r.block(torch.cat([h, x0], 1), "rb2")
        h = r.block(torch.cat([h, x0], 1), "rb3")
        pose, transl = pose + r.linear(h, "out_p"), transl + r.linear(h, "out_t")
        rotations = r.rotations(pose)
    return posed(rotations, transl).detach().numpy() + middle


def test_imported_networks_grasp_as_the_published_ones_do(tmp_path, hand, cache_dir):
    """From the file of a mesh to vertices: centre, points, kinds of distance, networks, and the way back."""
    coarse, fine = coarsenet_state(), refinenet_state()
    plausible(coarse, fine)
    basis = np.random.default_rng(0).normal(scale=0.07, size=(1, N_BPS, 3)).astype(np.float32)
    np.savez(tmp_path / "bps.npz", basis=basis)
    for name, state, *option in (
        ("coarsenet", coarse, "--bps", tmp_path / "bps.npz"),
        ("refinenet", fine, "--hand-model", OPEN_HANDS / "MANO_RIGHT.npz"),
    ):
        output = tmp_path / "published" / name / "model.safetensors"
        done = run(name, save(tmp_path, state, f"{name}.pt"), *option, "--output", output)
        assert (done.returncode, done.stderr) == (0, "")
        assert read_conventions(output) == Conventions(
            "box", "samples", "samples", 2048, 10_000, False, hand.fingerprint if name == "refinenet" else None
        )
    mesh = uneven_mesh(tmp_path / "object.ply")
    assert np.linalg.norm(np.mean(mesh.vertices, 0) - np.mean(mesh.bounds, 0)) > 0.01

    grabber = Grabber.from_pretrained(tmp_path / "published", hand, optimise=0, candidates=1)
    grasps = grabber(tmp_path / "object.ply", 6, seed=4, orientation="fixed", cache_dir=cache_dir)
    latent = torch.from_numpy(np.random.default_rng([4, 0]).standard_normal((6, LATENT), np.float32)).double()
    expected = published_grasps(mesh, basis[0], coarse, fine, latent)
    np.testing.assert_allclose(grasps.vertices, expected, atol=1e-4, rtol=0)
    # Any other convention moves the hands by far more.
    both = (grabber.generator.coarsenet, grabber.generator.refinenet)
    known = [network.conventions for network in both]
    for name, value in (("centre", "mean_vertex"), ("distance_to", "surface"), ("basis_to", "surface")):
        for network, conventions in zip(both, known, strict=True):
            network.conventions = replace(conventions, **{name: value})
        other = grabber(tmp_path / "object.ply", 6, seed=4, orientation="fixed", cache_dir=cache_dir)
        assert np.linalg.norm(other.vertices.numpy() - expected, axis=-1).mean() > 5e-4, name
