"""The command `grabnet benchmark`; its values are explained by `--help`."""

import sys

from grabnet.commands.benchmark import main

if __name__ == "__main__":
    sys.exit(main())
