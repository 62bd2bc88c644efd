"""What a failing pair leaves: both images, their difference, a map of p-values, and a line of cause."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sfsnet_dr.apply.display import png_bytes, show_linear
from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.base.imageio import write_exr
from sfsnet_dr.render.agreement import two_sided_p
from sfsnet_dr.report.figures import error_map
from sfsnet_dr.report.record import dotted
from sfsnet_dr.study.regress.diagnose import diagnose
from sfsnet_dr.study.regress.matrix import Row

Array = npt.NDArray[np.float64]

_CLEAREST = 12.0  # decades of p at the end of the map's scale
_ENLARGED = 4


@dataclass(frozen=True, eq=False)
class Evidence:
    """A failing pair in pictures.

    Attributes:
        row: the pair.
        cause: one line.
        pictures: PNG and label: image, reference, difference, p-values.
    """

    row: Row
    cause: str
    pictures: tuple[tuple[bytes, str], ...]


def gather(row: Row, folder: Path) -> Evidence:
    """Write the evidence of a pair that differs into a folder of its own below ``folder``."""
    assert row.image is not None
    assert row.truth is not None
    assert row.agreement is not None
    image, reference = row.image.mean, row.truth.estimate.mean
    cause = diagnose(row.image, row.truth).words
    # The most telling colour of each pixel.
    decades = -np.log10(np.maximum(two_sided_p(row.agreement.z), 1e-300)).max(axis=-1)
    pictures = _pictures(image, reference, decades)
    place = output_dir(folder / "failures" / "-".join(map(dotted, (row.renderer, row.scene, row.light))))
    planes = {"image": image, "reference": reference, "difference": image - reference}
    channels = {f"{name}.{c}": values[..., k] for name, values in planes.items() for k, c in enumerate("RGB")}
    write_exr(place / "images.exr", channels | {"decades_of_p.Y": decades}, {}, float32=[*channels])
    for png, label in pictures:
        (place / f"{dotted(label.split(',')[0])}.png").write_bytes(png)
    write_text(place / "cause.txt", f"{row.renderer}, {row.scene}, {row.light}: {cause}\n")
    return Evidence(row, cause, pictures)


def _pictures(image: Array, reference: Array, decades: Array) -> tuple[tuple[bytes, str], ...]:
    scale = 0.7 / max(
        float(np.quantile(reference[reference > 0], 0.99)) if (reference > 0).any() else 1.0, 1e-9
    )
    difference = (image - reference).mean(axis=-1)
    limit = max(float(np.quantile(np.abs(difference), 0.995)), 1e-12)
    power = max(float(np.sqrt((reference**2).mean())), 1e-12)
    return (
        (_enlarged(image * scale), "image"),
        (_enlarged(reference * scale), "reference"),
        (
            error_map(
                difference / power, label="difference / RMS of reference", limit=limit / power, signed=True
            ),
            "difference, relative",
        ),
        (error_map(decades, label="-log10 p of the pixel", limit=_CLEAREST), "p-values, in decades"),
    )


def _enlarged(image: Array) -> bytes:
    return png_bytes(show_linear(np.maximum(image, 0.0).repeat(_ENLARGED, axis=0).repeat(_ENLARGED, axis=1)))
