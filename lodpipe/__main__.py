"""``python -m lodpipe``: the same program as ``lodpipe``."""

import sys

from lodpipe.cli import main

if __name__ == "__main__":
    sys.exit(main())
