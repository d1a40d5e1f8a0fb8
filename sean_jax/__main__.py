"""``python -m sean_jax`` is ``sean``."""

import sys

from sean_jax.cli.command_line import main

if __name__ == "__main__":
    sys.exit(main())
