"""`python -m jaxreplay` is the command line."""

import sys

from jaxreplay.cli import main

sys.exit(main())
