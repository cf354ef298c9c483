"""The command `grabnet ship`; its arguments are explained by `--help`."""

import sys

from grabnet.commands.ship_weights import main

if __name__ == "__main__":
    sys.exit(main())
