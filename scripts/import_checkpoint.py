"""The command `grabnet import`; its arguments are explained by `--help`."""

import sys

from grabnet.commands import run

if __name__ == "__main__":
    sys.exit(run("import"))
