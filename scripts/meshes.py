"""The command `grabnet meshes`; its values are explained by `--help`."""

import sys

from grabnet.commands import run

if __name__ == "__main__":
    sys.exit(run("meshes"))
