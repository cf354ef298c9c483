"""The command `grabnet mosh`; its values are explained by `--help`."""

import sys

from grabnet.commands.mosh import main

if __name__ == "__main__":
    sys.exit(main())
