"""``python -m hamsym`` is the ``hamsym`` command."""

import sys

from hamsym.cli.commands import main

sys.exit(main())
