"""The command `grabnet analyze`; its values are explained by `--help`."""

import sys

from grabnet.commands import run

if __name__ == "__main__":
    sys.exit(run("analyze"))
