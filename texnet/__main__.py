"""python -m texnet: the command line."""

import sys

from .cli import main

sys.exit(main())
