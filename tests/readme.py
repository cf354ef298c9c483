"""The commands of the README: what its blocks hold, in the order of the page.

`python tests/readme.py [SECONDS]` (`make readme`) runs them all as they are printed, one after the other, in a copy of
the repository. What is not done after so many seconds is stopped by Ctrl-C, and counts as working.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
SECONDS = 60.0
# What needs a network, a cluster, GPUs, or files that are not ours: a part of its command, and how this one ends then;
# None where it is not run.
MISSING = {
    "pip install": None,
    "make test": None,
    "models=[runs/demo,open]": "runs/demo",  # the demo takes longer
    "data.root=GRAB": "GRAB holds no recordings",
    "dask_address=": "",
    "hydra/launcher=submitit_slurm": "",
    "trainer=ddp": "The trainer cannot be had as configured",
    "grasps=others/grasps": "Folder of grasps others/grasps does not exist",
    "build_open.py hand": "anny",
    "build_open.py body": "anny",
}


def blocks(language: str, text: str | None = None) -> list[str]:
    """Blocks of the README in a language, in order."""
    text = (ROOT / "README.md").read_text(encoding="utf-8") if text is None else text
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(text: str | None = None) -> list[str]:
    """Command lines of the README, without comments and line ends."""
    lines = "".join(blocks("sh", text)).replace("\\\n", " ").splitlines()
    return [command for line in lines if (command := re.sub(r"(^|\s+)#.*", "", line).strip())]


def words(command: str) -> list[str]:
    """A command line as the shell passes it on, but for its globs."""
    return shlex.split(command)


def run_all(folder: Path, seconds: float) -> list[str]:
    """Run every command, so many seconds at most, in a copy of the repository; the failures."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(folder)], check=True)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(folder),
    }
    (folder / ".venv").mkdir()
    for part in Path(sys.prefix).iterdir():
        if part.name != ".ready":
            (folder / ".venv" / part.name).symlink_to(part)
    (folder / ".venv/.ready").touch()  # for make
    subprocess.run([sys.executable, "-c", _CUP], cwd=folder, check=True)
    failures = []
    for command in [*commands(), *(shlex.join(["python", "-c", block]) for block in blocks("python"))]:
        print(f"$ {command}", flush=True)
        sentence = next((end for part, end in MISSING.items() if part in command), "ok")
        if sentence is None:
            continue
        output = tempfile.TemporaryFile("w+")  # noqa: SIM115, of this command
        process = subprocess.Popen(
            command, shell=True, cwd=folder, env=environment, stdout=output, stderr=output, start_new_session=True
        )
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)
            process.wait()
            code = 0
        output.seek(0)
        said = output.read()
        fits = code == 0 if sentence == "ok" else code == 0 or sentence in said
        if not fits or ("Traceback" in said and code):
            failures.append(f"{command}\n{said[-2000:]}")
    return failures


_CUP = "import trimesh; trimesh.creation.cylinder(0.035, 0.1).export('cup.obj')"

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        found = run_all(Path(place) / "grabnet", float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS)
    print("\n".join(f"FAILED: {failure}" for failure in found) or "All commands work.")
    sys.exit(bool(found))
