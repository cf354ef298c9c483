"""However a command ends, it says so in a line: bad places, numbers, signals, terminals and pipes."""

import errno
import os
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from grabnet.cli.ends import as_user_error, in_sentences, note, say, unexpected
from grabnet.cli.entry import hydra_entry
from grabnet.cli.places import refuse_unwritable
from grabnet.commands import COMMANDS
from grabnet.errors import UserError
from grabnet.io.files import replacing
from tests.faults import files_of_at_most

ROOT = Path(__file__).parents[2]
# How each command is given a place to write to; it must be refused before anything is read or computed.
WRITERS = {
    "sample": "mesh=a.obj output={}",
    "evaluate": "output={}",
    "train": "run_dir={}",
    "preprocess": "output={}",
    "analyze": "output={}",
    "meshes": "sequence=s1/mug_lift_1 output={}",
    "benchmark": "suite=hand output={}",
    "unpack": "downloads {}",
    "import": "coarsenet a.pt --bps a.npz --output {}",
    "ship": "run {}",
    "build": "objects --root {}",
    "build ": "hand --folder {}",
    "build  ": "grasps --file {}",
    "build   ": "body --folder {}",
    "build    ": "sequences --root {}",
    "build     ": "film a.npz --output {}",
    "mosh": "capture=a.c3d out={}",
    "mosh ": "synthesise out={}",
    "mosh  ": "judge truth=a solved=b output={}",
    "mosh   ": "place output={}",
    "mosh    ": "draw output={}",
    "study": "export output={}",
    "study ": "analyse export=a output={}",
    "study  ": "simulate output={}",
    "study   ": "power output={}",
}
IS_FILE = {"mosh  ", "mosh   ", "mosh    ", "benchmark", "import", "build  ", "build     ", "study   "}


def said(capsys, monkeypatch, name: str, *arguments: str) -> tuple[int, str]:
    """Exit code and stderr of a command, in this process."""
    monkeypatch.setattr(sys, "argv", [f"grabnet {name.strip()}", *arguments])
    with pytest.raises(SystemExit) as left:
        import_module(COMMANDS[name.strip()][0]).main()
    return left.value.code, capsys.readouterr().err


@pytest.fixture
def places(tmp_path) -> dict[str, Path]:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    return {
        "file": tmp_path / "file",
        "below": tmp_path / "file/x",
        "loop": tmp_path / "loop/x",
        "proc": Path("/proc/x/y"),
        "long": tmp_path / ("x" * 300),
    }


@pytest.mark.parametrize("name", WRITERS)
def test_a_place_that_cannot_be_written_to_is_refused_at_once(name, places, capsys, monkeypatch):
    places["file"] = places["file"].parent if name in IS_FILE else places["file"]  # where a folder is in the file's way
    for place in places.values() if name in ("sample", "build") else [places["file"], places["long"]]:
        code, line = said(capsys, monkeypatch, name, *WRITERS[name].format(place).split())
        assert code == 2 and line.count("\n") == 1, line
        assert line.startswith(f"error: {place} cannot be written to (") and "): choose another " in line
    assert (places["below"].parent).read_text() == "mine"


def test_a_place_that_can_be_written_to_stays_as_it_is(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "new", target_is_directory=True)
    for path, is_folder in [(tmp_path, True), (tmp_path / "a/b", True), (tmp_path / "a.json", False)]:
        refuse_unwritable(path, "output", is_folder)
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        ("sample", "mesh=", "mesh is ''; it must not be empty."),
        ("sample", "mesh=[]", "mesh is []; it must not be empty."),
        ("sample", "cup.obj", "The argument 'cup.obj' has no value: give it as mesh=cup.obj."),
        ("sample", "mesh=a.obj runs=", "runs is empty: give a file or folder as runs=…"),
        ("sample", "mesh=a.obj n=1000000000", "n is 1000000000; it must be at most 1000000."),
        ("sample", "mesh=a.obj betas=[nan]", "betas is nan; it must be a finite number."),
        ("sample", "mesh=a.obj betas=[100]", "betas is 100; it must be at most 10."),
        ("sample", "mesh=a.obj betas=[]", "betas is []; it must not be empty."),
        ("sample", "mesh=a.obj scale=1e400", "scale is inf; it must be a finite number."),
        ("sample", "mesh=a.obj seed=99999999999999999999", "it must be at most 4294967295."),
        ("benchmark", "hand", "The argument 'hand' has no value: give it as suite=hand."),
        ("benchmark", "suite=hand threads=100000", "threads is 100000; it must be at most "),
        ("benchmark", "suite=hand batch=99999999999", "batch is 99999999999; it must be at most 65536."),
        ("preprocess", "workers=100000", "workers is 100000; it must be at most "),
        ("evaluate", "contact_distance=nan", "contact_distance is nan; it must be a finite number."),
        ("evaluate", "physics.shake.friction=-1", "physics.shake.friction is -1; it must be above 0."),
        (
            "train",
            "refinenet",
            "give it as hparams_search=refinenet or loss=refinenet or model=refinenet.",
        ),
        ("train", "--experimental-rerun=x.pickle", "--experimental-rerun would run what a pickle says"),
        ("train", "hydra.mode=x", "Error merging override hydra.mode=x (Invalid value 'x', expected one of"),
        ("build", "hand --seed -1", "argument --seed: -1 is out of range; it must be at least 0;"),
        ("build", "objects --processes 100000", "argument --processes: 100000 is out of range; it must be at most "),
        ("build", "sequences --number x", "argument --number: invalid whole number value: 'x';"),
        ("unpack", "", "the following arguments are required: downloads, root;"),
    ],
)
def test_what_is_wrong_with_the_line_is_said_before_any_work(name, arguments, sentence, capsys, monkeypatch):
    code, line = said(capsys, monkeypatch, name, *arguments.split())
    assert code == 2 and line.count("\n") == 1
    assert line.startswith("error: ") and sentence in line


def ended(raises: BaseException, capsys) -> tuple[int, str]:
    with pytest.raises(SystemExit) as left, in_sentences():
        raise raises
    return left.value.code, capsys.readouterr().err


def test_what_the_system_refuses_is_named(tmp_path, capsys):
    error = OSError(errno.EACCES, os.strerror(errno.EACCES), str(tmp_path / "a"))
    error.add_note("The rest is whole.")
    sentence = f"error: {tmp_path}/a cannot be used (Permission denied): choose another place. The rest is whole.\n"
    assert ended(error, capsys) == (2, sentence)
    assert ended(MemoryError("Unable to allocate 7 GiB"), capsys)[1].startswith("error: The memory does not suffice (U")


def test_a_full_disk_names_the_file_that_was_written(tmp_path):
    with files_of_at_most(100), pytest.raises(OSError) as caught, replacing(tmp_path / "big.bin") as temporary:
        temporary.write_bytes(b"x" * 1000)
    assert str(as_user_error(caught.value)) == (
        f"{tmp_path}/big.bin cannot be used (File too large): make room, or choose another place."
    )
    assert not list(tmp_path.iterdir())


def test_a_fault_of_ours_is_told_as_such(capsys):
    def fault():
        return compile_nothing()

    def compile_nothing():
        return [][1]

    with pytest.raises(IndexError) as caught:
        fault()
    assert unexpected(caught.value).startswith("Unexpected IndexError: list index out of range")
    code, line = ended(caught.value, capsys)
    assert code == 2 and "please report it" in line and "Traceback" not in line and line.count("\n") == 1


def test_a_fault_within_a_command_is_told_as_such(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmark", "suite=hand"])
    with pytest.raises(SystemExit) as left:
        hydra_entry("benchmark")(lambda cfg: [][1])()
    said = capsys.readouterr().err
    assert left.value.code == 2 and said.count("\n") == 1 and said.startswith("error: Unexpected IndexError: ")


def test_nothing_in_a_sentence_steers_the_terminal(capsys):
    say("a\x1b[2Jb\rc\u202ed é")
    note("a\x1b[2Jb\rc\u202ed é")
    out, err = capsys.readouterr()
    assert err == "error: a\\x1b[2Jb c\\u202ed é\n"
    assert out == "a\\x1b[2Jb\\rc\\u202ed é\n"


SLEEPS = """
import sys, time
from grabnet.cli.ends import in_sentences
with in_sentences():
    print("ready é \\udcff", flush=True)
    {}
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_in_a_line(number, code):
    process = subprocess.Popen(
        [sys.executable, "-c", SLEEPS.format("time.sleep(60)")],
        cwd=ROOT,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stdout.readline() == "ready \\xe9 \\udcff\n"  # characters that the terminal has not
    process.send_signal(number)
    _, line = process.communicate(timeout=30)
    assert process.returncode == code
    assert line.startswith(f"error: stopped by {number.name}") and line.count("\n") == 1


def test_a_reader_that_goes_away_is_no_fault():
    process = subprocess.Popen(
        [sys.executable, "-c", SLEEPS.format("[print(i, flush=True) for i in range(10**6)]")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.readline()
    process.stdout.close()
    assert process.wait(30) == 141 and process.stderr.read() == b""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_stdout_is_told():
    command = [sys.executable, "-c", SLEEPS.format("pass").replace(", flush=True", "")]
    with Path("/dev/full").open("w") as full:
        process = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert process.returncode == 2
    assert process.stderr == (
        "error: A file, the output or a connection cannot be used (No space left on device): make room, or choose "
        "another place.\n"
    )


def test_a_user_error_is_a_sentence_and_2(capsys):
    assert ended(UserError("No."), capsys) == (2, "error: No.\n")
