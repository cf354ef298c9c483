"""`python -m grabnet`: the command `grabnet`."""

import sys

from grabnet.commands import main

if __name__ == "__main__":
    sys.exit(main())
