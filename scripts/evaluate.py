"""The command `grabnet evaluate`; its values are explained by `--help`."""

import sys

from grabnet.commands.evaluate import main

if __name__ == "__main__":
    sys.exit(main())
