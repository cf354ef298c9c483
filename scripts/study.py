"""The command `grabnet study`; its values are explained by `--help`."""

import sys

from grabnet.commands.study import main

if __name__ == "__main__":
    sys.exit(main())
