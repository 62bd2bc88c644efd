"""All methods on one set of faces: records, a table, and a page with pictures.

The page shows people; it goes where its caller wants it and never among stored results.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch

from sfsnet_dr.apply.display import on_white, sheet, show_albedo, show_linear, show_normals
from sfsnet_dr.apply.methods import Method, for_capture
from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.data.surface_labels import SurfaceLabels
from sfsnet_dr.data.yale_b import LIGHTS_19
from sfsnet_dr.report.html import Figure, Section, Table, write_page
from sfsnet_dr.report.record import Record, dotted, write_records
from sfsnet_dr.study.evaluate.measure import measure
from sfsnet_dr.study.evaluate.summary import records_of

#: Columns of the table: what a record is called after its method, the heading, digits.
COLUMNS: Final = (
    ("normals.mean_deg", "normals (deg)", 1),
    ("normals.std_deg", "std", 1),
    ("normals.below20", "< 20 (%)", 1),
    ("normals.below25", "< 25", 1),
    ("normals.below30", "< 30", 1),
    ("normals.angle77_180.mean_deg", "beyond 77 (deg)", 1),
    ("albedo.scaled_rms", "albedo", 3),
    ("recon.mae", "MAE", 1),
    ("recon.rmse", "RMSE", 1),
    ("lights.top1", "19 lights (%)", 1),
    ("lights64.top1", "all lights (%)", 1),
    ("lights.direction_deg", "direction (deg)", 1),
    ("images_per_s", "images/s", 1),
)


def evaluate(
    data: str,
    faces: Sequence[SurfaceLabels],
    methods: Sequence[Method],
    out: Path | str,
    command: str,
    *,
    lights: Sequence[str] | None = None,
    on_method: Callable[[], object] = lambda: None,
) -> list[Record]:
    """Measure methods and write ``records.json``, ``table.csv`` and ``index.html``.

    Args:
        data: name of the data, first word of the records.
        faces: with their truth.
        methods: with different names.
        out: folder, made if missing.
        command: for the records.
        lights: names of those that take part; all if not given.
        on_method: called after each method.
    """
    folder = output_dir(out)
    records: list[Record] = []
    for method in methods:
        records += records_of(data, measure(method, faces, lights), command, LIGHTS_19)
        on_method()
    write_records(folder / "records.json", records)
    names = [method.name for method in methods]
    table = _table(data, names, records)
    write_text(folder / "table.csv", _csv(table))
    _page(folder / "index.html", data, faces, methods, table)
    return records


def _table(data: str, names: Sequence[str], records: Sequence[Record]) -> Table:
    values = {record.what: record.value for record in records}
    rows = []
    for name in names:
        cells = []
        for what, _, digits in COLUMNS:
            value = values.get(f"{dotted(data)}.{dotted(name)}.{what}")
            cells.append("-" if value is None else f"{value:.{digits}f}")
        rows.append([name, *cells])
    return Table(
        ["method", *(heading for _, heading, _ in COLUMNS)],
        rows,
        "Normals: angle to those of photometric stereo over the pixels of the face. Albedo: RMS error "
        "relative to the true RMS after the best factor. MAE and RMSE: of the reconstruction, 8-bit sRGB "
        "units. Lights: top-1 classification, one subject left out.",
    )


def _csv(table: Table) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([table.headers, *table.rows])
    return text.getvalue()


def _page(
    path: Path, data: str, faces: Sequence[SurfaceLabels], methods: Sequence[Method], table: Table
) -> None:
    subjects = len({face.subject for face in faces})
    lead = (
        f"{len(methods)} methods on {sum(len(face.lights) for face in faces)} photographs of {subjects} "
        "people whose normals and albedo are known from photometric stereo with all of their lights."
    )
    pictures = Figure(
        _pictures(faces, methods),
        "A face under a frontal and an oblique light: the photograph, the normals known, and each method's "
        "normals, albedo and reconstruction.",
        density=1,
    )
    sections = [Section("In numbers", [table]), Section("In pictures", [pictures])]
    write_page(path, f"Evaluation on {data}", lead, sections)


def _pictures(faces: Sequence[SurfaceLabels], methods: Sequence[Method]) -> bytes:
    face = faces[0]
    mask = face.mask[0].numpy()
    order = np.argsort(-face.direction[:, 2].numpy())
    cells = []
    for row in (int(order[0]), int(order[int(0.7 * len(order))])):
        image = face.images[row : row + 1]
        cells.append((f"light {face.lights[row]}", show_linear(_picture(image[0]))))
        cells.append(("normals known", on_white(show_normals(_picture(face.normal)), mask)))
        while len(cells) % 3:
            cells.append(("", np.full((128, 128, 3), 255, np.uint8)))
        for method in methods:
            with torch.no_grad():
                answer = for_capture(method, face.name)(image, face.mask[None], [face.subject])
            normal, albedo, drawn = (
                _picture(part[0]) for part in (answer.normal, answer.albedo, answer.image)
            )
            shown = {
                "normals": show_normals(normal),
                "albedo": show_albedo(albedo, mask),
                "reconstruction": show_linear(drawn),
            }
            cells += [(f"{method.name}: {what}", on_white(part, mask)) for what, part in shown.items()]
    return sheet(cells, columns=3)


def _picture(planes: torch.Tensor) -> np.typing.NDArray[np.float64]:
    return np.moveaxis(np.nan_to_num(planes.double().numpy()), 0, -1)
