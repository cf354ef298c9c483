"""The package as users get it: built, installed away from the checkout, and used there by its command."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
import trimesh
from packaging.requirements import Requirement

import grabnet

ROOT = Path(__file__).parents[1]
METADATA = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Python's modules that Windows lacks.
UNIX = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints; nothing of this checkout is on its path."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel made from a source distribution, which is made from this checkout."""
    folder = tmp_path_factory.mktemp("build")
    made_here = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, folder / "checkout", ignore=lambda at, names: made_here(at, names) | ignored(at))
    sdist = "from setuptools.build_meta import build_sdist; build_sdist('..')"
    run(sys.executable, "-c", sdist, cwd=folder / "checkout")
    offline = ("--no-index", "--no-deps", "--no-build-isolation", "--quiet")
    run(sys.executable, "-m", "pip", "wheel", *offline, *folder.glob("*.tar.gz"), cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


def ignored(folder: str) -> set[str]:
    """What users put into the checkout's top."""
    return {"data", "runs", "multirun", "outputs", "shared"} if Path(folder) == ROOT else set()


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment that has the wheel, and the dependencies from this one, but not the checkout."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, symlinks=True)
    python = folder / "bin/python"
    offline = ("--no-index", "--no-deps", "--quiet")
    run(sys.executable, "-m", "pip", "--python", python, "install", *offline, wheel, cwd=folder)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    # A folder named in a .pth file is searched, but its own .pth files, such as an editable install's, are not read.
    (site / "dependencies.pth").write_text("\n".join({sysconfig.get_path(k) for k in ("purelib", "platlib")}))
    return folder


def test_the_wheel_holds_code_configs_assets_and_licences(wheel):
    expected = {f"{METADATA['name']}-{METADATA['version']}.dist-info/licenses/LICENSE"}
    for source, target in [("grabnet", "grabnet"), ("hydra_plugins", "hydra_plugins")]:
        expected |= {f"{target}/{p.relative_to(ROOT / source)}" for p in files(source) if p.suffix in (".py", ".html")}
    expected |= {str(p.relative_to(ROOT)) for p in files("grabnet/study/page")}
    for source in ("configs", "assets"):
        expected |= {f"grabnet/{p.relative_to(ROOT)}" for p in files(source)}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name or name in expected}
    assert held == expected
    assert {"grabnet/generation/viewer.html", "grabnet/assets/open_hand/LICENSE"} < held


def files(folder: str) -> list[Path]:
    return [p for p in (ROOT / folder).rglob("*") if p.is_file() and "__pycache__" not in p.parts]


def test_the_installed_package_finds_its_files_and_hydra_its_plugins(environment, tmp_path):
    script = """
import sys, grabnet
from grabnet.io.shipped import shipped
print(grabnet.__file__, grabnet.__version__, shipped("configs"), shipped("assets"), "torch" in sys.modules)
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
print(*(found.__module__ for found in Plugins.instance().discover(Sweeper)))
"""
    facts, sweepers = run(environment / "bin/python", "-c", script, cwd=tmp_path).splitlines()
    *places, with_torch = facts.replace(METADATA["version"], "").split()
    assert len(places) == 3 and all(Path(place).is_relative_to(environment) for place in places)
    assert with_torch == "False"  # nobody who asks for --help should wait for it
    assert {"hydra_plugins.grabnet_grid", "hydra_plugins.grabnet_search"} < set(sweepers.split())


def test_the_command_samples_in_an_empty_folder(environment, tmp_path):
    (tmp_path / "ball.ply").write_bytes(trimesh.creation.icosphere(3, 0.035).export(file_type="ply"))
    run(environment / "bin/grabnet", "sample", "mesh=ball.ply", "n=2", "output=grasps", "cache_dir=cache", cwd=tmp_path)
    folder = tmp_path / "grasps/ball"
    assert {"grasps.json", "grasps.npz", "index.html"} <= {p.name for p in folder.iterdir()}
    assert len(list((folder / "meshes").glob("*.glb"))) == 2


def test_the_command_explains_training(environment, tmp_path):
    help_text = run(environment / "bin/grabnet", "train", "--help", cwd=tmp_path)
    assert "max_epochs" in help_text and "coarsenet" in help_text
    assert not list(tmp_path.iterdir())


def test_the_lowest_versions_are_those_that_are_tested():
    """The bounds of all dependencies, and of those extras that the tests with the lowest versions use."""
    lines = (ROOT / "requirements-lowest.txt").read_text().splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    extras = METADATA["optional-dependencies"]
    declared = [Requirement(r) for r in (*METADATA["dependencies"], *extras["evaluation"], *extras["test"])]
    lowest = {r.name: s.version for r in declared for s in r.specifier if s.operator == ">="}
    assert pinned == {name: version for name, version in lowest.items() if name in pinned}
    assert {r.name for r in declared[: len(METADATA["dependencies"])]} <= pinned.keys()


def test_what_the_package_offers_is_listed_and_there():
    offered = dir(grabnet)
    assert {"Grabber", "HandModel", "Mesh", "load_mesh", "UserError", "__version__"} <= set(offered)
    for name in offered:
        assert getattr(grabnet, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Graber'"):
        _ = grabnet.Graber


def test_every_module_can_be_imported_without_what_windows_lacks(environment, tmp_path):
    """Only our own imports are refused: other packages look at the platform."""
    script = f"""
import builtins, importlib, pkgutil

def imported(name, globals=None, *rest, **keywords):
    importer = (globals or {{}}).get("__name__", "").partition(".")[0]
    if importer in ("grabnet", "hydra_plugins") and name.partition(".")[0] in {UNIX}:
        raise ModuleNotFoundError(f"{{globals['__name__']}} imports {{name}}")
    return original(name, globals, *rest, **keywords)

original, builtins.__import__ = builtins.__import__, imported
for package in ("grabnet", "hydra_plugins"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        if module.name.startswith(("grabnet", "hydra_plugins.grabnet")):
            importlib.import_module(module.name)
            print(module.name)
"""
    imported = run(environment / "bin/python", "-c", script, cwd=tmp_path).split()
    assert len(imported) > 200 and {"grabnet.preprocess.resuming", "hydra_plugins.grabnet_search"} < set(imported)
