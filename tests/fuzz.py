"""Mutated files for every reader: each ends in a value or in one printable sentence, in bounded time and memory.

`python -m tests.fuzz [mutations of each file] [seed]` is the long run, of `make fuzz`; tests/io/test_fuzz.py a
short one.
"""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import random
import resource
import signal
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from safetensors.torch import load as load_tensors
from safetensors.torch import save

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.data.frames import FramesStore, finish_store, read_header, shard_path, start_store, write_shard
from grabnet.data.sequences import read_sequence, write_sequence
from grabnet.data.sources.grabnet_release import read_subjects
from grabnet.data.sources.release_comparison import ComparisonRecord
from grabnet.data.sources.release_names import read_frame_names
from grabnet.data.unpacking import unpack
from grabnet.errors import UserError, printable
from grabnet.evaluation.generated import read_grasps
from grabnet.geometry.bps import BPS
from grabnet.io.files import write_json
from grabnet.io.npz import npz_rows, read_npy
from grabnet.io.pickles import decode_pickle
from grabnet.io.recipes import claim
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.trained import find_model, find_network
from grabnet.models.weights import load_network, save_network
from grabnet.open.grasps.store import OPEN_GRASPS, load_open_grasps
from grabnet.open.sequences.building import Entry, _reported
from grabnet.preprocess.finishing import HEADER
from grabnet.sweeps.report import row
from grabnet.sweeps.runs import Run
from grabnet.training.checkpoints import read_checkpoint
from grabnet.training.run import _earlier, _refuse_other_settings
from tests.data.grab import random_sequence

SECONDS, MEMORY = 20, 3 << 30  # that one file may take; of the second what the process has on top
_HOSTILE: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 1.5, -0.0, 1e308, float("nan"), float("inf"), 10**12, -(2**63), 2**64, 10**30, "",
    "x", "\x1b[31mred", "\ud800", "../../etc/passwd", "a" * 300, "\0", [], {}, [[]], [None], {"": None}, [1, [2, [3]]],
)  # fmt: skip


@dataclass(frozen=True)
class Target:
    """A file and who reads it.

    file: whole, and mutated in place. read: of the file; may do with the value what a command would.
    mutate: further mutations, which know the format.
    """

    file: Path
    read: Callable[[Path], Any]
    mutate: Callable[[bytes, random.Random], bytes] | None = None


def mutations(target: Target, number: int, seed: int) -> Iterator[bytes]:
    """Mutated contents, the same for the same seed."""
    whole = target.file.read_bytes()
    for k in range(number):
        chance = random.Random(f"{seed} {target.file.name} {k}")
        knows = target.mutate is not None and chance.random() < 0.6
        yield target.mutate(whole, chance) if knows else mutated_bytes(whole, chance)


def mutated_bytes(data: bytes, chance: random.Random) -> bytes:
    """Bits flipped, bytes set, inserted, removed, repeated, or the end cut off, once or a few times."""
    content = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 8))):
        n = len(content)
        near = chance.randrange(min(n, 200) + 1)  # headers lie at the beginning and at the end
        at = chance.choice((chance.randrange(n + 1), near, n - near))
        some = bytes(chance.randrange(256) for _ in range(chance.choice((1, 4, 8))))
        how = chance.randrange(6)
        if how == 0 and at < n:
            content[at] ^= 1 << chance.randrange(8)
        elif how == 1:
            content[at : at + len(some)] = chance.choice((some, b"\xff" * len(some), bytes(len(some))))
        elif how == 2:
            content[at:at] = some
        elif how == 3:
            del content[at : at + chance.choice((1, 10, 1000))]
        elif how == 4:
            content[at:at] = content[at : at + chance.choice((1, 10, 1000))]
        else:
            del content[at:]
    return bytes(content)


def mutated_value(value: Any, chance: random.Random) -> Any:
    """A value of JSON in which one part is another, is missing, or stands twice."""
    value = json.loads(json.dumps(value))
    places = list(_places(value))
    if not places or chance.random() < 0.05:
        return chance.choice(_HOSTILE)
    whole, key = chance.choice(places)
    how = chance.random()
    if how < 0.7:
        whole[key] = chance.choice(_HOSTILE)
    elif how < 0.85:
        del whole[key]
    elif isinstance(whole, list):
        whole.insert(key, whole[key])
    else:
        whole[f"{key}2"] = whole[key]
    return value


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    for key in list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield value, key
        yield from _places(value[key])


def mutated_json(data: bytes, chance: random.Random) -> bytes:
    return json.dumps(mutated_value(json.loads(data), chance)).encode("utf-8", "surrogatepass")


def mutated_yaml(data: bytes, chance: random.Random) -> bytes:
    value = mutated_value(OmegaConf.to_container(OmegaConf.create(data.decode())), chance)
    if chance.random() < 0.5:
        return json.dumps(value).encode("utf-8", "surrogatepass")  # which is YAML, too
    aliases, date = "a: &a [1, 1]\nb: &b [*a, *a]\n", "x: 2001-01-01\n"
    tails = (aliases, date, "x: ${y}\n", "x: !!python/name:os.system\n", "? [1]\n: 2\n")
    return data + chance.choice(tails).encode()


def mutated_tensors(data: bytes, chance: random.Random) -> bytes:
    """A safetensors file with another header, or with numbers that are none."""
    length = int.from_bytes(data[:8], "little")
    header, rest = json.loads(data[8 : 8 + length]), data[8 + length :]
    how = chance.random()
    if how < 0.3:
        at = chance.randrange(max(1, len(rest) // 4)) * 4
        rest = rest[:at] + chance.choice((b"\0\0\xc0\x7f", b"\0\0\x80\x7f", b"\xff\xff\x7f\x7f")) + rest[at + 4 :]
    elif how < 0.7 and "__metadata__" in header:
        facts = header["__metadata__"]
        name = chance.choice(list(facts))
        try:
            facts[name] = json.dumps(mutated_value(json.loads(facts[name]), chance))
        except ValueError:
            facts[name] = chance.choice(("", "\x1b[31m", "RefineNet", "null", "[" * 10_000))
    else:
        header = mutated_value(header, chance)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + rest


def mutated_npy(data: bytes, chance: random.Random) -> bytes:
    """An array with another header, and its length set right."""
    length = int.from_bytes(data[8:10], "little")
    text, rest = data[10 : 10 + length].decode("latin1"), data[10 + length :]
    numbers = ("0", "1", "-1", "1000000000000", "(((((((", "9" * 40, "True", "None", "1.5", "1000000000000, 0", "2**99")
    codes = ("|O", "<U1", "<U0", "|S0", "<f2", ">f8", "|V8", "<M8[s]", "f4,f4", "|b1", "<U99999999", "<c16")
    how = chance.random()
    if how < 0.5:
        text = text.replace("'shape': (", f"'shape': ({chance.choice(numbers)}, ", 1)
    elif how < 0.8:
        at = text.index("'descr': '") + 10
        text = text[:at] + chance.choice(codes) + text[text.index("'", at) :]
    else:
        deep = "(" * 9000 + ")" * 9000
        text = chance.choice((text[:-20], "{" * 3000, deep, text.replace("False", "True"), "__import__('os')"))
    content = text.encode("latin1", "replace")
    return data[:8] + len(content).to_bytes(2, "little") + content + rest


def mutated_npz(data: bytes, chance: random.Random) -> bytes:
    """An archive whose sums are right and of whose members one is another, is missing, or stands twice."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    k = chance.randrange(len(members))
    name, content = members[k]
    how = chance.random()
    if how < 0.45 and content.startswith(b"\x93NUMPY"):
        members[k] = name, mutated_npy(content, chance)
    elif how < 0.8:
        members[k] = name, mutated_bytes(content, chance)
    elif how < 0.87:
        del members[k]
    elif how < 0.93:
        members.append(members[k])
    else:
        hostile = ("", "/", "..", "../x", "a/b.npy", "\x1b[31m.npy", "x" * 300, "._a.npy", "__MACOSX/a.npy")
        members[k] = chance.choice(hostile), content
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def failure_of(target: Target, content: bytes) -> str | None:
    """What is wrong with how a content is read; None where it ends as it should."""
    target.file.write_bytes(content)
    signal.signal(signal.SIGALRM, _out_of_time)
    signal.alarm(SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.read(target.file)
    except UserError as error:
        sentence = str(error)
        fine = printable(sentence) == sentence and len(sentence) < 4100 and sentence.endswith(".")
        return None if fine else f"no sentence: {sentence!r}"
    except BaseException as error:  # all of these are what is looked for
        lines = traceback.extract_tb(error.__traceback__)[-3:]
        at = " < ".join(f"{Path(line.filename).name}:{line.lineno}" for line in reversed(lines))
        return f"{type(error).__name__}: {str(error)[:200]!r} at {at}"
    finally:
        signal.alarm(0)
    return None


def _out_of_time(*_: Any) -> None:
    raise TimeoutError(f"more than {SECONDS} s")


def targets(folder: Path) -> dict[str, Target]:
    """Every reader with a small whole file, by name."""
    hand = HandModel.open()
    made: dict[str, Target] = {}
    sequence = random_sequence(3)
    write_sequence(folder / "root/grab/s1/mug_pass_1.npz", sequence)
    made["sequence"] = Target(folder / "root/grab/s1/mug_pass_1.npz", read_sequence, mutated_npz)
    values = {"x": np.arange(4.0), "y": [np.float32(1), "mug", {1, 2}], "z": {"s": (1, [b"a", None])}, "big": 2**70}
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        file = folder / f"{protocol}.pkl"
        file.write_bytes(pickle.dumps(values, protocol))
        made[f"pickle {protocol}"] = Target(file, lambda file: str(decode_pickle(file.read_bytes(), "file")))
    small = folder / "MANO_RIGHT.npz"
    small.write_bytes((OPEN_HANDS / "MANO_RIGHT.npz").read_bytes())
    made["hand model"] = Target(small, HandModel, mutated_npz)
    pickled = folder / "MANO_RIGHT.pkl"
    pickled.write_bytes(pickle.dumps(dict(np.load(OPEN_HANDS / "MANO_RIGHT.npz")), 2))
    made["pickled hand model"] = Target(pickled, HandModel)
    np.save(folder / "array.npy", np.arange(6).reshape(2, 3))
    made["array"] = Target(folder / "array.npy", read_npy, mutated_npy)
    info = {"s1": {"gender": "male", "rh_vtemp": np.zeros((778, 3))}}
    np.save(folder / "sbj_info.npy", np.array(info, object), allow_pickle=True)
    subjects = folder / "sbj_info.npy"
    made["subjects of the release"] = Target(subjects, lambda file: read_subjects(file, 778), mutated_npy)
    np.savez(folder / "frame_names.npz", np.array(["x/s1/mug_pass_1/00001.npz", "x/s1/mug_pass_1/00002.npz"]))
    made["frame names"] = Target(folder / "frame_names.npz", read_frame_names, mutated_npz)
    np.savez(folder / "train.npz", transl=np.zeros((5, 3), np.float32), other=np.zeros(3))
    made["rows"] = Target(folder / "train.npz", lambda file: list(npz_rows(file, "transl", 2)), mutated_npz)
    np.savez(folder / "bps.npz", basis=np.zeros((1, 8, 3)))
    made["basis"] = Target(folder / "bps.npz", BPS.load, mutated_npz)
    made |= _of_networks(folder, hand) | _of_stores(folder, hand) | _of_runs(folder) | _of_grasps(folder, hand)
    return made


def _of_networks(folder: Path, hand: HandModel) -> dict[str, Target]:
    torch.manual_seed(0)
    record = {"trained_from": {}, "hand_sha256": None, "config": {}}
    coarse, fine = folder / "coarse/model.safetensors", folder / "fine/model.safetensors"
    save_network(coarse, CoarseNet(BPS(8), latent_dim=2, width=4, n_hidden=4), record)
    save_network(fine, RefineNet(hand, width=4, n_hidden=4), record)

    def use(file: Path) -> None:
        load_network(file, hand)
        find_model(file.parent)
        find_network("CoarseNet", None, file.parent)

    checkpoint = folder / "last.ckpt"
    torch.save({"state_dict": {"a": torch.zeros(3)}, "epoch": 1, "callbacks": {"History": {"epochs": []}}}, checkpoint)
    return {
        "CoarseNet": Target(coarse, use, mutated_tensors),
        "RefineNet": Target(fine, lambda file: load_network(file, hand), mutated_tensors),
        "checkpoint": Target(checkpoint, read_checkpoint, mutated_npz),
    }


def _of_stores(folder: Path, hand: HandModel) -> dict[str, Target]:
    store = folder / "store"
    values = {"global_orient": 3, "hand_pose": 45, "transl": 3, "object_orient": 3}
    tensors = {name: torch.zeros(2, width) for name, width in values.items()} | {"frame": torch.arange(2)}
    counts = {"waterfall": {"in all": 2}, "fingers": dict.fromkeys(HEADER["counts"]["fingers"], 0)}
    facts = {"template": "a.ply", "inputs": {"a": "b"}, "counts": counts}
    start_store(store, {"format": 1, "filter": {"lift": 0.1}}, "delete it")
    write_shard(store, "s1/mug_lift_1", "s1", "mug", tensors, intent="lift", **facts)
    finish_store(store, hand.fingerprint, {"s1": torch.zeros(778, 3)}, ["mug"], {"made": "now"})
    shard = shard_path(store, "s1/mug_lift_1")

    def load(file: Path) -> None:
        FramesStore.load(store)
        read_header(shard, HEADER)

    write_json(folder / "compared.json", {"recipe": {"a": 1}, "turns_rows": True, "splits": {
        "train": {"frames": 2, "arrays": {"verts": {"sum": 0.5, "max": 0.1}}}}})  # fmt: skip

    def compare(file: Path) -> None:
        record = ComparisonRecord(file, {"a": 1})
        record.millimetres(), record.frames("train"), record.turns_rows

    recipe = {"format": 1, "filter": {"lift": 0.1}}
    return {
        "store": Target(store / "store.json", load, mutated_json),
        "shard": Target(shard, load, mutated_tensors),
        "subjects": Target(store / "subjects.safetensors", load, mutated_tensors),
        "recipe": Target(store / "recipe.json", lambda file: claim(file, recipe, "delete it"), mutated_json),
        "comparison": Target(folder / "compared.json", compare, mutated_json),
    }


def _of_runs(folder: Path) -> dict[str, Target]:
    run = folder / "sweep/run"
    write_json(run / "history.json", [{"epoch": k, "seconds": 1.5, "val/loss": 0.5, "val/v2v": 3.0} for k in range(2)])
    write_json(run / "outcome.json", {"status": "failed", "reason": "no data"})
    done = folder / "done/run"
    write_json(done / "metrics.json", {"val/loss": 0.5, "val/v2v": 3.0})
    record = {"made": "now", "versions": {"torch": "2"}, "machine": "Linux", "commit": None, "trained_from": {}}
    write_json(folder / "provenance.json", record | {"earlier": []})
    config = OmegaConf.create({"seed": 1, "model": {"width": 4}, "tags": ["a"], "objective": "val/loss"})
    OmegaConf.save(config, folder / "config.yaml")
    write_json(folder / "open/reports/s1/mug_lift_1.json", {"frames": 5, "rejected": {"a": 1}, "given_up": 30})
    entry = Entry(0, "s1/mug_lift_1", "s1", "mug", "lift")
    of_run, of_done = Run(run, (), {"lr": "1"}), Run(done, (), {"lr": "1"})
    return {
        "history": Target(run / "history.json", lambda file: row(of_run, "val/loss"), mutated_json),
        "outcome": Target(run / "outcome.json", lambda file: row(of_run, "val/loss"), mutated_json),
        "metrics": Target(done / "metrics.json", lambda file: of_done.metrics(), mutated_json),
        "provenance": Target(folder / "provenance.json", _earlier, mutated_json),
        "config": Target(folder / "config.yaml", lambda file: _refuse_other_settings(file, config), mutated_yaml),
        "report": Target(
            folder / "open/reports/s1/mug_lift_1.json", lambda file: _reported(folder / "open", entry), mutated_json
        ),
    }


def _of_grasps(folder: Path, hand: HandModel) -> dict[str, Target]:
    place, mesh = folder / "grasps/mug", folder / "mug.ply"
    place.mkdir(parents=True)
    mesh.write_bytes(b"ply")
    arrays = {"global_orient": np.zeros((2, 3)), "hand_pose": np.zeros((2, 45)), "transl": np.zeros((2, 3))}
    np.savez(place / "grasps.npz", side=np.array("right"), betas=np.zeros((2, 10)), **arrays)
    write_json(place / "grasps.json", {"mesh_sha256": None, "grasps": [{"index": 0}]})
    shipped = folder / "grasps.safetensors"
    stored = load_tensors(OPEN_GRASPS.read_bytes())
    tensors = {name: value[:3].clone() for name, value in stored.items() if name not in ("betas", "subject")}
    tensors |= {"subject": torch.zeros(3, dtype=torch.uint8), "betas": torch.zeros(1, 10)}
    names = {"objects": ["mug"] * 99, "subjects": ["s1"], "genders": ["male"], "kinds": ["power"] * 9}
    shipped.write_bytes(save(tensors, {"grasps": json.dumps(names | {"seed": 1})}))
    archive = folder / "downloads/grab__s1.zip"
    archive.parent.mkdir()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("mug_lift_1.npz", "more/cup_lift_1.npz"):
            file.writestr(zipfile.ZipInfo(name), b"content" * 20)

    def read(file: Path) -> None:
        read_grasps(folder / "grasps", "mug", mesh, hand, 10)

    def unpacked(file: Path) -> None:
        with tempfile.TemporaryDirectory(dir=folder) as place, contextlib.redirect_stdout(io.StringIO()):
            root = Path(place) / "inside/root"
            failures = unpack(file.parent, root)
            assert all(p.is_dir() or p.is_relative_to(root) for p in Path(place).rglob("*"))
            for failure in failures:
                raise UserError(failure)

    return {
        "grasps": Target(place / "grasps.npz", read, mutated_npz),
        "record of grasps": Target(place / "grasps.json", read, mutated_json),
        "shipped grasps": Target(shipped, load_open_grasps, mutated_tensors),
        "archive": Target(archive, unpacked, mutated_npz),
    }


def main(number: int = 500, seed: int = 0) -> int:
    """Mutate each file so often, and print what fails."""
    with tempfile.TemporaryDirectory() as folder:
        found = targets(Path(folder))
        limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        failed = 0
        for name, target in found.items():
            whole = target.file.read_bytes()
            assert failure_of(target, whole) is None, (name, failure_of(target, whole))
            failures: dict[str, int] = {}
            for content in mutations(target, number, seed):
                target_failure = failure_of(target, content)
                if target_failure is not None:
                    failures[target_failure] = failures.get(target_failure, 0) + 1
            target.file.write_bytes(whole)
            failed += sum(failures.values())
            print(f"{name}: {sum(failures.values())} of {number} end in neither a value nor a sentence", flush=True)
            for failure, times in sorted(failures.items(), key=lambda item: -item[1])[:12]:
                print(f"    {times} × {failure}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
