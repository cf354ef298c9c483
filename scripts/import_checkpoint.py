"""The command `grabnet import`; its arguments are explained by `--help`."""

import sys

from grabnet.commands.import_checkpoint import main

if __name__ == "__main__":
    sys.exit(main())
