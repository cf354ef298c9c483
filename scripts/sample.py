"""The command `grabnet sample`; its values are explained by `--help`."""

import sys

from grabnet.commands.sample import main

if __name__ == "__main__":
    sys.exit(main())
