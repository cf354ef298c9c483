"""The command `grabnet train`; its values are explained by `--help`."""

import sys

from grabnet.commands.train import main

if __name__ == "__main__":
    sys.exit(main())
