"""Command lines as people type them: values, file names, help, exit codes."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from omegaconf import DictConfig, ListConfig, OmegaConf

from grabnet.cli.entry import CONFIGS, compose, hydra_entry
from grabnet.cli.quoting import quoted
from grabnet.commands import COMMANDS
from grabnet.commands.mosh import COMMANDS as MOSH
from grabnet.commands.study import COMMANDS as STUDY
from grabnet.errors import UserError

ROOT = Path(__file__).parents[2]
CONFIG = {name: name for name in ("train", "evaluate", "benchmark")} | {
    name: f"{name}/{name}" for name in ("sample", "preprocess", "analyze", "mosh")
}
CONFIG["meshes"] = "analyze/meshes"
CONFIG |= {f"study {name}": f"study/{name}" for name in STUDY} | {f"mosh {name}": f"mosh/{name}" for name in MOSH}
# Command lines that together have every value of a command.
LINES = {
    "sample": ["mesh=a.obj", "mesh=a.obj hand_model=a.npz model=[runs/a,runs/b]"],
    "benchmark": ["suite=hand"],
    "mosh": ["capture=a.c3d"],
    "preprocess": ["data=open data.contact=recompute"],
    "analyze": ["compare=grasps compare.root=a", "compare=grab compare.root=a compare.models=a"],
    "meshes": ["sequence=s1/mug_lift_1"],
    "evaluate": [
        "",
        "hand_model=mano hand_model.path=a.npz",
        "data=grabnet_release data.source.release=a objects.dir=a",
        "source=guesses_to_recorded source.coarsenet=a",
    ],
    "train": [
        "",
        "model=refinenet",
        "model=refinenet source=guesses_to_recorded model.source.coarsenet=a",
        "model=refinenet source=samples_perturbed model.source.coarsenet=a",
        "model=grabnet",
        "data=grabnet_release data.source.release=a objects.dir=a",
        "hand_model=mano hand_model.path=a.npz",
        "callbacks=pruning logger=wandb scheduler=cosine trainer=ddp",
    ],
    **{f"study {name}": ["export=a"] if name in ("serve", "analyse") else [""] for name in STUDY},
    **{f"mosh {name}": ["truth=a solved=b"] if name == "judge" else [""] for name in MOSH},
}
BOTH = [(command, line) for command, lines in LINES.items() for line in lines]
AWKWARD = "/ö x/läuf (1), b=c~d/#'2'"


def leaves(node, path=""):
    """Keys and values of a config, as written."""
    for key in node:
        child, full = node._get_node(key), f"{path}.{key}".lstrip(".")
        if isinstance(child, DictConfig) and not child._is_none() and len(child):
            yield from leaves(child, full)
        else:
            yield full, child._value() if not isinstance(child, ListConfig) else list(child)


def typed(value) -> str:
    if isinstance(value, list):
        return f"[{','.join(map(typed, value))}]"
    if value is None:
        return "null"
    if isinstance(value, str) and re.search(r"[\s,'=]", value):  # a text, which is quoted
        return "'" + value.replace("'", r"\'") + "'"
    return str(value).lower() if isinstance(value, bool) else str(value)


def names(command: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Of the values that are a file name, and that may be several."""
    name, *part = command.split()
    module = import_module(COMMANDS[name][0])
    paths, lists = module.PATHS, getattr(module, "LISTS", {} if part else ())
    own = part[0] if part else ""
    return paths[own] if isinstance(paths, dict) else paths, lists.get(own, ()) if isinstance(lists, dict) else lists


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    env = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=env, capture_output=True, text=True)


@pytest.mark.parametrize(("command", "line"), BOTH)
def test_every_value_can_be_given_on_the_command_line(command, line):
    standard = compose(CONFIG[command], line.split())
    given = [f"{key}={typed(value)}" for key, value in leaves(standard)]
    assert len(given) > 5
    again = compose(CONFIG[command], [*line.split(), *quoted(given, *names(command))])
    assert OmegaConf.to_container(again) == OmegaConf.to_container(standard)


@pytest.mark.parametrize(("command", "line"), BOTH)
def test_files_may_have_any_name(command, line):
    paths, lists = names(command)
    known = [key for key, _ in leaves(compose(CONFIG[command], line.split())) if key in (*paths, *lists)]
    assert known
    arguments = [f"{key}={AWKWARD}{key}" for key in known if key not in lists]
    several = {"format": "[glb,ply]"}
    arguments += [f"{key}={several.get(key, '[é.obj,~/(2).obj]')}" for key in known if key in lists]
    cfg = compose(CONFIG[command], [*line.split(), *quoted(arguments, paths, lists)])
    for key in known:
        value = OmegaConf.select(cfg, key)
        if key == "format":
            assert value == ["glb", "ply"]
        elif key in lists:
            assert value == ["é.obj", str(Path.home() / "(2).obj")]
        else:
            assert value == f"{AWKWARD}{key}"


@pytest.mark.parametrize("command", LINES)
def test_no_file_name_is_forgotten(command):
    paths, lists = names(command)
    keys = {key for line in LINES[command] for key, _ in leaves(compose(CONFIG[command], line.split()))}
    assert {*paths, *lists} <= keys
    looks = re.compile(r"(^|\.)(\w*dir|root|path|folder|output|release|runs|mesh|grasps|\w+net)$")
    other = {"callbacks.grasps.grasps", {"benchmark": "runs", "study power": "grasps"}.get(command)}  # numbers
    assert {key for key in keys if looks.search(key)} - other <= {*paths, *lists}


@pytest.mark.parametrize(
    ("script", "arguments", "sentence"),
    [
        ("train.py", ["run_dir={}/läuf(1)", "data=frames", "data.root=~/n ö(1)"], "Frames store {}/n ö(1)/frames"),
        ("scripts/preprocess.py", ["data.root=~/n ö(1),=", "output={}/(2)"], "{}/n ö(1),= holds no recordings"),
        ("scripts/sample.py", ["mesh=~/n ö(1).obj", "output={}/(3)"], "{}/n ö(1).obj"),
    ],
)
def test_awkward_names_and_home_arrive_on_a_real_command_line(script, arguments, sentence, tmp_path):
    ended = run(script, *(a.format(tmp_path) for a in arguments), HOME=str(tmp_path))
    assert ended.stderr.startswith("error: ") and sentence.format(tmp_path) in ended.stderr
    assert "Traceback" not in ended.stderr and "Lexer" not in ended.stderr
    assert ended.returncode in (1, 2)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_explains_the_command(command):
    ended = run("-m", "grabnet", command, "--help")
    assert ended.returncode == 0 and not ended.stderr
    assert f"grabnet {command}" in ended.stdout and "Exit codes:" in ended.stdout
    if command in CONFIG:
        own = (CONFIGS / f"{CONFIG[command]}.yaml").read_text()
        for line in own.splitlines():
            if re.match(r"(?!hydra)[a-z_]+: .*#", line):  # the command's own values with their comments
                assert line in ended.stdout
        # Groups are those that the command has, and no others.
        shown = set(re.findall(r"^  (\w+)=", ended.stdout.split("──")[0], flags=re.MULTILINE))
        listed = set(re.findall(r"^  - (\w+)[@\w]*:", own, flags=re.MULTILINE)) - {"hydra"}
        folders = [(CONFIGS / CONFIG[command]).parent, CONFIGS / "shared"]
        folders += [CONFIGS / "data"] if command == "preprocess" else []
        assert shown == {group for group in listed if any(len([*f.glob(f"{group}/*.yaml")]) > 1 for f in folders)}


def test_help_shows_the_files_of_the_groups_that_are_chosen():
    ended = run("train.py", "model=refinenet", "scheduler=cosine", "--help")
    for file in (
        "model/refinenet",
        "loss/refinenet",
        "source/recorded_perturbed",
        "scheduler/cosine",
        "trainer/default",
    ):
        assert f"── {file}.yaml, below {file.split('/')[0] if file[:5] in ('model', 'train') else ''}" in ended.stdout
    assert "dropout: 0.3 # share of features" in ended.stdout and "latent_dim:" not in ended.stdout


def test_the_program_lists_its_commands_and_says_what_is_near():
    ended = run("-m", "grabnet", "--help")
    assert ended.returncode == 0 and all(f"  {name} " in ended.stdout for name in COMMANDS)
    assert re.fullmatch(r"grabnet \S.*\n", run("-m", "grabnet", "--version").stdout)
    for name, hint in {"sampel": "did you mean sample?", "x": "it can be sample, train, "}.items():
        ended = run("-m", "grabnet", name)
        assert ended.returncode == 2 and ended.stderr.startswith(f"error: There is no command '{name}'; {hint}")


def test_listing_commands_imports_nothing_slow():
    code = "import sys, grabnet.commands as c; sys.argv = ['grabnet']; c.main(); sys.exit('torch' in sys.modules)"
    assert run("-c", code).returncode == 0


def test_a_folder_of_your_own_configs_is_searched(tmp_path):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment/mine.yaml").write_text("# @package _global_\nseed: 7\n")
    (tmp_path / "other.yaml").write_text("defaults:\n  - train\n  - _self_\nseed: 8\n")
    more = [f"--config-dir={tmp_path}", "data=frames", "data.root=/nowhere", f"run_dir={tmp_path}/run"]
    for name, choice, seed in (("train", "mine", "7"), ("other", "null", "8")):
        arguments = [*more, f"--config-name={name}"] + ([f"experiment={choice}"] if choice != "null" else [])
        ended = run("train.py", *arguments)
        assert ended.returncode == 2 and ended.stderr.startswith("error: Frames store /nowhere/frames"), ended.stderr
        assert run("train.py", *arguments, "--cfg", "job", "-p", "seed").stdout.strip() == seed
    assert run("train.py", *more, "experiment=none").stderr.startswith("error: There is no experiment 'none'; ")
    assert run("train.py", "--config-dir=/nowhere").stderr == "error: --config-dir /nowhere is no folder.\n"
    assert run("train.py", "model=corsenet", "--help").stderr.startswith(
        "error: There is no model 'corsenet'; model can"
    )
    assert run("train.py", "--config-name=x").stderr == "error: There is no config 'x'.\n"


@pytest.mark.parametrize(
    ("arguments", "shows"),
    [
        (["--hydra-help"], "Hydra"),
        (["--cfg", "job"], "matmul_precision: high"),
        (["--info", "searchpath"], "Config search path"),
        (["-sc", "install=bash"], "hydra_bash_completion"),
    ],
)
def test_hydras_own_options_work(arguments, shows):
    ended = run("train.py", *arguments)
    assert ended.returncode == 0 and shows in ended.stdout + ended.stderr


def test_keys_and_values_are_completed():
    for command in (["train.py"], ["-m", "grabnet"]):
        line = "python train.py mod" if command == ["train.py"] else "grabnet train mod"
        assert run(*command, "-sc", "query=bash", COMP_LINE=line).stdout.split() == ["model.", "model="]
    assert "mesh=" in run("-m", "grabnet", "-sc", "query=bash", COMP_LINE="grabnet sample me").stdout
    assert run("-m", "grabnet", "-sc", "query=bash", COMP_LINE="grabnet s").stdout.split() == list(COMMANDS)
    assert "grabnet" in run("-m", "grabnet", "-sc", "install=bash").stdout.splitlines()[-1]


def ended_by(monkeypatch, main, *arguments: str) -> int | str | None:
    """The exit code of a command that does what `main` does."""
    monkeypatch.setattr(sys, "argv", ["benchmark", "suite=hand", *arguments])
    try:
        return hydra_entry("benchmark")(main)()
    except SystemExit as left:
        return left.code


def test_the_exit_code_is_the_commands(monkeypatch, capsys, tmp_path):
    def refuse(cfg):
        if cfg.seed == 1:
            raise UserError("No.")
        print(f"seed {cfg.seed}")

    assert ended_by(monkeypatch, lambda cfg: 0) == 0
    assert ended_by(monkeypatch, lambda cfg: 1) == 1
    assert ended_by(monkeypatch, lambda cfg: 0.5) == 0  # an objective
    assert ended_by(monkeypatch, refuse, "seed=1") == 2
    assert capsys.readouterr().err == "error: No.\n"
    sweep = ("-m", f"hydra.sweep.dir={tmp_path}")
    assert ended_by(monkeypatch, lambda cfg: int(cfg.seed == 0), *sweep, "seed=0,2") == 1
    assert ended_by(monkeypatch, refuse, *sweep, "seed=0,1,2") == 1
    printed = capsys.readouterr()
    assert printed.err == "error: No.\n" and printed.out.endswith("seed 0\nseed 2\n")


def test_scripts_are_the_commands():
    for file in [ROOT / "train.py", *(ROOT / "scripts").glob("*.py")]:
        name = re.search(r"`grabnet (\w+)`", file.read_text())[1]
        assert f'run("{name}")' in file.read_text()
        assert len(file.read_text().splitlines()) < 10
    assert {file.stem for file in (ROOT / "scripts").glob("*.py")} | {"train"} == {
        module.rpartition(".")[2] for module, _ in COMMANDS.values()
    }
