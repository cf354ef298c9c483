"""The command `grabnet build`; its arguments are explained by `--help`."""

import sys

from grabnet.commands.build_open import main

if __name__ == "__main__":
    sys.exit(main())
