"""The command `grabnet preprocess`; its values are explained by `--help`."""

import sys

from grabnet.commands.preprocess import main

if __name__ == "__main__":
    sys.exit(main())
