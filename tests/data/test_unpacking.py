"""GRAB's zip files: to the right folders, resumable, and nothing of a hostile one."""

from __future__ import annotations

import stat
import subprocess
import sys
import warnings
import zipfile

import pytest

from grabnet.cli.entry import CONFIGS
from grabnet.data.unpacking import target_folder, unpack, unpack_archive
from grabnet.errors import UserError

SCRIPT = CONFIGS.parent / "scripts" / "unpack_grab.py"


def zipped(path, files, mode=zipfile.ZIP_DEFLATED):
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", mode) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def tree(root):
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.fixture
def downloads(tmp_path):
    folder = tmp_path / "downloads"
    zipped(folder / "grab__s1.zip", {"mug_pass_1.npz": b"one", "cup_lift.npz": b"two" * 1000})
    zipped(folder / "tools__object_meshes__contact_meshes.zip", {"mug.ply": b"ply", "more/cup.ply": b"ply2"})
    return folder


def test_archives_go_where_their_names_say(downloads, tmp_path):
    assert unpack(downloads, tmp_path / "GRAB") == []
    assert tree(tmp_path / "GRAB") == {
        "grab/s1/mug_pass_1.npz": b"one",
        "grab/s1/cup_lift.npz": b"two" * 1000,
        "tools/object_meshes/contact_meshes/mug.ply": b"ply",
        "tools/object_meshes/contact_meshes/more/cup.ply": b"ply2",
    }


def test_a_second_run_writes_only_what_is_missing(downloads, tmp_path):
    root = tmp_path / "GRAB"
    unpack(downloads, root)
    before = tree(root)
    kept = root / "grab/s1/mug_pass_1.npz"
    stamp = kept.stat().st_mtime_ns
    (root / "tools/object_meshes/contact_meshes/mug.ply").unlink()
    (root / "grab/s1/cup_lift.npz").write_bytes(b"cut short")
    unpack(downloads, root)
    assert tree(root) == before
    assert kept.stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    "name", ["../evil", "a/../../evil", "/tmp/evil", "C:/evil", "..\\evil", "a\\..\\..\\evil", "//host/evil"]
)
def test_paths_that_lead_out_are_refused(tmp_path, name):
    archive = zipped(tmp_path / "grab__s1.zip", {"fine.npz": b"fine", name: b"evil"})
    with pytest.raises(UserError, match="leads out of"):
        unpack_archive(archive, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB")
    assert not (tmp_path / "GRAB").exists(), "not even the files before it"


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR])
def test_links_and_devices_are_refused(tmp_path, kind):
    member = zipfile.ZipInfo("link")
    member.create_system, member.external_attr = 3, (kind | 0o777) << 16
    archive = zipped(tmp_path / "grab__s1.zip", {member: b"/etc/passwd"})
    with pytest.raises(UserError, match="is a link or device"):
        unpack_archive(archive, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB")
    assert not (tmp_path / "GRAB").exists()


def test_links_that_lie_there_are_not_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "GRAB").mkdir()
    (tmp_path / "GRAB/grab").symlink_to(tmp_path / "elsewhere")
    archive = zipped(tmp_path / "grab__s1.zip", {"a.npz": b"a"})
    with pytest.raises(UserError, match="through a link"):
        unpack_archive(archive, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_bombs_are_refused_before_they_unpack(tmp_path):
    archive = zipped(tmp_path / "grab__s1.zip", {f"{k}.npz": bytes(10**6) for k in range(5)})
    assert archive.stat().st_size < 10**5
    with pytest.raises(UserError, match="unpacks to 5,000,000 bytes; at most 4,000,000"):
        unpack_archive(archive, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB", max_bytes=4 * 10**6)
    assert not (tmp_path / "GRAB").exists()


def test_a_size_that_lies_does_not_get_more_written(tmp_path):
    """Declared as ten bytes, packed as a million."""
    archive = zipped(tmp_path / "grab__s1.zip", {"a.npz": bytes(10**6)}, zipfile.ZIP_STORED)
    data = bytearray(archive.read_bytes())
    size = (10**6).to_bytes(4, "little")
    at = data.rindex(size)  # of the directory at the end: sizes packed and unpacked
    assert data[at - 4 : at] == size
    data[at : at + 4] = (10).to_bytes(4, "little")
    archive.write_bytes(data)
    with pytest.raises(UserError, match="no whole zip file"):
        unpack_archive(archive, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB", max_bytes=100)
    assert not tree(tmp_path / "GRAB")


@pytest.mark.parametrize("name", ["__.zip", "grab__...zip", "a__ __b.zip", "....zip"])
def test_names_without_a_folder_are_refused(tmp_path, name):
    with pytest.raises(UserError, match="has a name that holds no folder"):
        target_folder(zipped(tmp_path / name, {"a": b"a"}), tmp_path / "GRAB")
    (failure,) = unpack(tmp_path, tmp_path / "GRAB")
    assert "has a name that holds no folder" in failure and not (tmp_path / "GRAB").exists()


def test_one_archive_goes_where_its_name_says_or_into_the_root(downloads, tmp_path):
    assert unpack(downloads / "grab__s1.zip", tmp_path / "GRAB") == []
    assert tree(tmp_path / "GRAB").keys() == {"grab/s1/mug_pass_1.npz", "grab/s1/cup_lift.npz"}
    plain = zipped(tmp_path / "grabnet.zip", {"data/bps.npz": b"bps", "data/train/frame_names.npz": b"names"})
    subprocess.run([sys.executable, SCRIPT, plain, tmp_path / "GrabNet"], check=True)
    assert tree(tmp_path / "GrabNet") == {"data/bps.npz": b"bps", "data/train/frame_names.npz": b"names"}


def test_one_bad_archive_does_not_stop_the_others(downloads, tmp_path):
    whole = downloads / "grab__s1.zip"
    (downloads / "grab__s2.zip").write_bytes(whole.read_bytes()[:-20])
    damaged = bytearray(whole.read_bytes())
    content = damaged.index(b"cup_lift.npz") + len("cup_lift.npz")
    damaged[content : content + 4] = b"oops"
    (downloads / "grab__s3.zip").write_bytes(damaged)
    done = subprocess.run(
        [sys.executable, SCRIPT, downloads, tmp_path / "GRAB"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 2 and "grab__s2.zip" in errors[0] and "grab__s3.zip" in errors[1]
    assert {"grab/s1/cup_lift.npz", "tools/object_meshes/contact_meshes/mug.ply"} <= tree(tmp_path / "GRAB").keys()


def test_no_archives_are_told(tmp_path):
    done = subprocess.run([sys.executable, SCRIPT, tmp_path, tmp_path / "GRAB"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"error: {tmp_path} holds no zip file: download GRAB into it first.\n"


CANNOT_LIE_THERE = {
    "a file that is a folder, too": (["a", "a/b.npz"], "both a file and a folder"),
    "a folder that is a file, too": (["a/b.npz", "a"], "both a file and a folder"),
    "no name": ([""], "names none"),
    "a name too long": (["x" * 300], "too long"),
    "a path too long": (["/".join(["x" * 200] * 30)], "too long"),
    "a NUL": (["a\0b"], "leads out of"),
    "two of one name": (["a.npz", "a.npz"], "two files"),
}


@pytest.mark.parametrize("name", CANNOT_LIE_THERE)
def test_what_cannot_lie_there_is_refused_before_anything_is_written(tmp_path, name):
    members, said = CANNOT_LIE_THERE[name]
    path = tmp_path / "grab__s1.zip"
    with zipfile.ZipFile(path, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for member in ("before.npz", *members):
            entry = zipfile.ZipInfo(member)
            entry.filename = entry.orig_filename = member
            archive.writestr(entry, b"content")
    with pytest.raises(UserError, match=said):
        unpack_archive(path, tmp_path / "GRAB/grab/s1", tmp_path / "GRAB")
    assert not tree(tmp_path / "GRAB")


def test_what_lies_in_the_way_is_told(downloads, tmp_path):
    (tmp_path / "GRAB/grab").mkdir(parents=True)
    (tmp_path / "GRAB/grab/s1").write_text("a file of the user's")
    (tmp_path / "GRAB/tools/object_meshes/contact_meshes/mug.ply").mkdir(parents=True)
    first, second = unpack(downloads, tmp_path / "GRAB")
    assert "grab/s1, a file, is in the way" in first and "both a file and a folder" in second
    assert (tmp_path / "GRAB/grab/s1").read_text() == "a file of the user's"


def test_a_damaged_member_does_not_stop_the_others(downloads, tmp_path):
    path = zipped(downloads / "grab__s4.zip", {f"{k}.npz": bytes([k]) * 1000 for k in range(5)}, zipfile.ZIP_STORED)
    path.write_bytes(path.read_bytes().replace(bytes([2]) * 1000, bytes([9]) * 1000))
    (failure,) = unpack(downloads, tmp_path / "GRAB")
    assert "1 of its 5 files are damaged, the first of them '2.npz'" in failure
    found = [name for name in tree(tmp_path / "GRAB") if "s4" in name]
    assert sorted(found) == [f"grab/s4/{k}.npz" for k in (0, 1, 3, 4)]


def test_copies_and_what_systems_add_are_left_out(downloads, tmp_path):
    whole = (downloads / "grab__s1.zip").read_bytes()
    for name in ("grab__s1 (1).zip", "grab__s1 copy.zip", "._grab__s1.zip"):
        (downloads / name).write_bytes(whole)
    names = ("mug.npz", "._mug.npz", "__MACOSX/._mug.npz", ".DS_Store")
    zipped(downloads / "grab__s2.zip", dict.fromkeys(names, b"content"))
    assert unpack(downloads, tmp_path / "GRAB") == []
    assert sorted(p.name for p in (tmp_path / "GRAB/grab").iterdir()) == ["s1", "s2"]
    assert [p.name for p in (tmp_path / "GRAB/grab/s2").iterdir()] == ["mug.npz"]


def test_an_archive_that_may_not_be_read_does_not_stop_the_others(downloads, tmp_path, monkeypatch):
    """As where its permissions forbid it, which they do not for root: it is gone when it is opened."""

    class Gone(zipfile.ZipFile):
        def __init__(self, path, *arguments):
            if path.name == "grab__s1.zip":
                path.unlink(missing_ok=True)
            super().__init__(path, *arguments)

    monkeypatch.setattr(zipfile, "ZipFile", Gone)
    failures = unpack(downloads, tmp_path / "GRAB")
    assert failures == [f"{downloads / 'grab__s1.zip'} cannot be read (No such file or directory)."]
    assert sorted(path.name for path in tmp_path.glob("GRAB/**/*.ply")) == ["cup.ply", "mug.ply"]
