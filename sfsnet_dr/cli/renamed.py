"""Old names of commands and options.

An old command is refused with its new name. An old option still works for one version, with a note on
standard error. Old keys of TOML files are listed beside the dataclass that reads them (``RENAMED``).
"""

from __future__ import annotations

from typing import Final

#: Command names of version 0.0, by what they are called now.
RENAMED_COMMANDS: Final[dict[str, str]] = {}

#: Options by command (new name): old option -> new option, both with the leading dashes.
RENAMED_OPTIONS: Final[dict[str, dict[str, str]]] = {}
