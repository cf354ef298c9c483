"""Build the open stand-ins for licensed data: hand, body, objects, grasps, sequences.

grabnet build hand               # the open hand, right and left (needs anny)
grabnet build objects            # object meshes, in the layout of GRAB
grabnet build grasps             # right-hand grasps of all objects (half an hour)
grabnet build body               # the open body with these hands (needs anny)
grabnet build sequences          # whole-body recordings in the layout of GRAB
grabnet build film FILE …        # a short video of some of them
grabnet build grasps --help      # the arguments of one of them
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from grabnet.cli.checks import Concurrent, Count, Seed, Several
from grabnet.cli.ends import note
from grabnet.cli.parsed import make_parser, number, run_parsed


def hand(arguments: argparse.Namespace) -> None:
    from grabnet.open.hand.build import build_hands

    if arguments.check:
        return check(build_hands, arguments.folder, n_adults=arguments.adults, seed=arguments.seed)
    report = build_hands(arguments.folder, n_adults=arguments.adults, seed=arguments.seed)
    note(f"Wrote MANO_RIGHT.npz and MANO_LEFT.npz to {arguments.folder}; on adults left out of the fit:")
    print(f"  joints {report.joint_error[0]:.2f} mm off on average, {report.joint_error[1]:.2f} mm at most;")
    print(f"  vertices {report.shape_error[0]:.2f} mm off on average, {report.shape_error[1]:.2f} mm at most.")
    if arguments.picture:
        from grabnet.body.hand import HandModel
        from grabnet.open.hand.sheet import hand_sheet
        from grabnet.visual.pictures import save_image

        save_image(arguments.picture, hand_sheet(HandModel(arguments.folder / "MANO_RIGHT.npz")))


def objects(arguments: argparse.Namespace) -> None:
    from grabnet.open.objects.writing import write_objects

    paths = write_objects(arguments.root, processes=arguments.processes)
    if arguments.picture:
        from grabnet.open.objects.sheet import objects_sheet
        from grabnet.visual.pictures import save_image

        save_image(arguments.picture, objects_sheet(paths))


def grasps(arguments: argparse.Namespace) -> None:
    from grabnet.open.grasps.building import build_grasps

    made = build_grasps(arguments.file, arguments.objects, arguments.per_object, arguments.seed, arguments.processes)
    if arguments.picture:
        from grabnet.open.grasps.sheet import draw_sheet

        draw_sheet(made, arguments.picture)


def body(arguments: argparse.Namespace) -> None:
    from grabnet.open.body.build import build_body

    if arguments.check:
        return check(build_body, arguments.folder)
    report = build_body(arguments.folder)
    note(f"Wrote SMPLX_NEUTRAL.npz and subjects.npz to {arguments.folder}; on adults left out of the fit:")
    print(f"  joints {report.joint_error[0]:.2f} mm off on average, {report.joint_error[1]:.2f} mm at most;")
    print(f"  vertices {report.shape_error[0]:.2f} mm off on average, {report.shape_error[1]:.2f} mm at most.")


def sequences(arguments: argparse.Namespace) -> None:
    from grabnet.open.sequences.building import build_sequences

    build_sequences(arguments.root, arguments.number, arguments.seed, arguments.processes, arguments.subjects)


def film(arguments: argparse.Namespace) -> None:
    from grabnet.open.sequences.film import save_film, save_strip

    save = save_strip if arguments.output.suffix == ".png" else save_film
    save(arguments.output, arguments.files, arguments.root)


def check(build: Callable[..., object], folder: Path, **options: object) -> None:
    """Build in another folder, and compare what comes out with the files of `folder`."""
    from grabnet.open.comparing import compare_models

    with TemporaryDirectory() as rebuilt:
        build(rebuilt, **options)
        for path in sorted(Path(rebuilt).iterdir()):
            array, difference = compare_models(path, folder / path.name)
            note(f"{folder / path.name}: at most {difference:.1e} off (in {array}).")


def main() -> int:
    parser = make_parser(__doc__)
    # A subparser for each kind of data; the code that makes it lies in grabnet/open/.
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="hand | body | objects | grasps | sequences | film"
    )

    command = commands.add_parser(
        "hand", help="the open hand, right and left, in MANO's schema", folders=["folder"], files=["picture"]
    )
    command.add_argument("--folder", type=Path, default=Path("assets/open_hand"), help="(default: %(default)s)")
    command.add_argument("--adults", type=number(Several), default=400, help="hands sampled (default: %(default)s)")
    command.add_argument("--seed", type=number(Seed), default=0, help="(default: %(default)s)")
    command.add_argument("--picture", type=Path, help="also draw poses and shapes here, such as docs/open_hand.png")
    command.add_argument("--check", action="store_true", help="write nothing: compare what is there with a new one")
    command.set_defaults(call=hand)

    command = commands.add_parser(
        "objects",
        help="mesh the open objects, one .ply each; those up to date are kept",
        folders=["root"],
        files=["picture"],
    )
    command.add_argument("--root", type=Path, default=Path("data/open"), help="dataset folder (default: %(default)s)")
    command.add_argument(
        "--processes", type=number(Concurrent), default=2, help="objects meshed at once (default: %(default)s)"
    )
    command.add_argument("--picture", type=Path, help="also draw them all here, such as docs/open_objects.png")
    command.set_defaults(call=objects)

    command = commands.add_parser(
        "grasps", help="grasps of the open objects by ten subjects, checked in simulation", files=["file", "picture"]
    )
    command.add_argument(
        "--file", type=Path, default=Path("assets/open_grasps/grasps.safetensors"), help="(default: %(default)s)"
    )
    command.add_argument("--objects", nargs="+", metavar="NAME", help="(default: all)")
    command.add_argument("--per-object", type=number(Count), default=220, help="grasps of each (default: %(default)s)")
    command.add_argument("--seed", type=number(Seed), default=0, help="(default: %(default)s)")
    command.add_argument(
        "--processes", type=number(Concurrent), default=2, help="objects at once (default: %(default)s)"
    )
    command.add_argument("--picture", type=Path, help="also draw random ones here, such as docs/open_grasps.png")
    command.set_defaults(call=grasps)

    command = commands.add_parser(
        "body", help="the open body in SMPL-X's schema, with the open hands", folders=["folder"]
    )
    command.add_argument("--folder", type=Path, default=Path("assets/open_body"), help="(default: %(default)s)")
    command.add_argument("--check", action="store_true", help="write nothing: compare what is there with a new one")
    command.set_defaults(call=body)

    command = commands.add_parser(
        "sequences", help="recordings of open bodies with open objects; those there are kept", folders=["root"]
    )
    command.add_argument("--root", type=Path, default=Path("data/open"), help="dataset folder (default: %(default)s)")
    command.add_argument("--number", type=number(Count), default=150, help="(default: %(default)s)")
    command.add_argument("--subjects", nargs="+", metavar="NAME", help="such as s1 s7 (default: all ten)")
    command.add_argument("--seed", type=number(Seed), default=0, help="(default: %(default)s)")
    command.add_argument(
        "--processes", type=number(Concurrent), default=2, help="sequences at once (default: %(default)s)"
    )
    command.set_defaults(call=sequences)

    command = commands.add_parser(
        "film", help="draw sequences, in motion (.webp, .gif) or as a strip of frames (.png)", files=["output"]
    )
    command.add_argument("files", type=Path, nargs="+", help="sequence files")
    command.add_argument("--root", type=Path, default=Path("data/open"), help="their folder (default: %(default)s)")
    command.add_argument("--output", type=Path, default=Path("sequences.webp"), help="(default: %(default)s)")
    command.set_defaults(call=film)

    return run_parsed(parser)
