"""Old names of commands and options.

An old command is refused with its new name. An old option still works for one version, with a note on
standard error. Old keys of TOML files are listed beside the dataclass that reads them (``RENAMED``).
"""

from __future__ import annotations

from typing import Final

#: Old command -> new command.
RENAMED_COMMANDS: Final[dict[str, str]] = {
    "stages": "train-all",
    "show": "contact-sheet",
    "fit-lights": "fit-light-prior",
    "weights mean": "weights average",
    "weights pack": "weights quantize",
}

#: Command (new name) -> old option -> new option.
RENAMED_OPTIONS: Final[dict[str, dict[str, str]]] = {
    "train": {
        "--labels": "--pseudo-labels",
        "--surfaces": "--normal-labels",
        "--start": "--init-weights",
    },
    "train-all": {"--surfaces": "--normal-labels"},
    "ablations": {"--surfaces": "--normal-labels"},
    "pseudo-label": {"--held-back": "--num-val", "--most": "--max-images"},
    "photometric-stereo": {"--lamps-by": "--calibrate-with", "--heads": "--prior-faces"},
    "evaluate": {"--most": "--max-images", "--once": "--no-tta"},
    "fit-light-prior": {"--most": "--max-images"},
    "weights average": {"--shares": "--coefficients"},
}
