"""`python -m jaxscan`: the command line where no script of its name is on the path."""

import sys

from jaxscan.cli.main import main


if __name__ == "__main__":
    sys.exit(main())
