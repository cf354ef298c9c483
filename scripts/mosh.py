"""The command `grabnet mosh`; its values are explained by `--help`."""

import sys

from grabnet.commands import run

if __name__ == "__main__":
    sys.exit(run("mosh"))
