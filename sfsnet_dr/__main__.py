"""``python -m sfsnet_dr`` is the command ``sfsnet-dr``."""

from __future__ import annotations

import sys

from sfsnet_dr.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
