"""The command `grabnet unpack`; its arguments are explained by `--help`."""

import sys

from grabnet.commands.unpack_grab import main

if __name__ == "__main__":
    sys.exit(main())
