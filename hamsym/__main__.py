"""``python -m hamsym`` is the ``hamsym`` command."""

import sys

from hamsym.cli import main

sys.exit(main())
