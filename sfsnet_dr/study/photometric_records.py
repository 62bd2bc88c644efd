"""What photometric stereo found, as records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from sfsnet_dr.data.listing import Listing
from sfsnet_dr.metrics.bootstrap import interval
from sfsnet_dr.report.record import Record, dotted, measured
from sfsnet_dr.study.photometric import Labelled

Array = npt.NDArray[np.float64]


def label_records(listing: Listing, found: Labelled, command: str) -> list[Record]:
    """``stereo.<database>.*``: captures, agreement of halves, gains, skipped files.

    ``halves_deg`` is the mean angle between the normals of two disjoint halves of each capture's lights,
    ``halves_equal_lamps_deg`` the same with all gains at 1; intervals are over captures.
    """
    head = f"stereo.{dotted(listing.database)}"

    def one(name: str, value: float, unit: str, ends: tuple[float, float] | None = None) -> Record:
        return measured(f"{head}.{name}", value, unit, command=command, interval=ends)

    records = [one("captures", len(found.labels), "1"), one("skipped", len(found.skipped), "1")]
    sets = {"halves_deg": found.halves, "halves_equal_lamps_deg": found.raw_halves}
    for name, values in sets.items():
        known = [value for value in values if np.isfinite(value)]
        if known:
            records.append(one(name, float(np.mean(known)), "degrees", _ends(known)))
    deviation = [np.log(value) for value in found.strobes.strength.values()]
    if deviation:
        records.append(one("lamps_std", float(np.std(deviation)), "1"))
        records.append(one("lamps_disagreement", found.strobes.spread, "1"))
        records.append(one("oblique_gain", found.strobes.oblique, "1"))
    records.append(one("mask_kept", float(np.mean(found.kept)), "1", _ends(found.kept)))
    return records


def lamp_records(listing: Listing, errors: Mapping[str, float], command: str) -> list[Record]:
    """``stereo.<database>.lamps_found`` and ``lamps_found_deg``, the mean angle to where they are known."""
    head, values = f"stereo.{dotted(listing.database)}", list(errors.values())
    found = len({photo.light for photo in listing.photos if photo.direction is not None})
    records = [measured(f"{head}.lamps_found", found, "1", command=command)]
    if values:
        mean = float(np.mean(values))
        records.append(
            measured(f"{head}.lamps_found_deg", mean, "degrees", command=command, interval=_ends(values))
        )
    return records


def check_records(errors: Mapping[int, Array], command: str) -> list[Record]:
    """``stereo.rendered.lights<N>.mean_deg``: mean angle to the true normals, intervals over faces.

    ``stereo.rendered.lights<N>.equal_lamps_deg`` is the same without estimating gains, which here are equal.
    """
    return [
        measured(
            f"stereo.rendered.lights{count}.{name}",
            float(values.mean()),
            "degrees",
            command=command,
            interval=_ends(list(values)),
        )
        for count, both in errors.items()
        for name, values in zip(("mean_deg", "equal_lamps_deg"), both.T, strict=True)
    ]


def _ends(values: Sequence[float]) -> tuple[float, float] | None:
    return tuple(interval(values)) if len(values) > 1 else None  # type: ignore[return-value]
