"""One case in this process: ``python -m sfsnet_dr.experiments.stability.child CASE FORM...``.

Prints one line of JSON for each form.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Final

from sfsnet_dr.experiments.stability import processes, repeated_calls
from sfsnet_dr.experiments.stability.process_case import Finding

#: Every case that needs a process of its own.
PROCESS_CASES: Final = (*repeated_calls.CASES, *processes.CASES)


def main(case_name: str, *form_names: str) -> None:
    """Print each finding on standard output as soon as it is there."""
    case = next(case for case in PROCESS_CASES if case.name == case_name)
    for name in form_names:
        try:
            finding = case.work(name)
        except Exception as error:  # whatever a form raises belongs into its row
            finding = Finding(0, f"{type(error).__name__}: {error}")
        print(json.dumps(asdict(finding)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
