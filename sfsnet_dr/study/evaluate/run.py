"""All methods on one collection of photographs: records, a table, and a page with pictures.

The page shows people; it goes where its caller wants it and never among stored results.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sfsnet_dr.apply.methods import Method
from sfsnet_dr.base.atomic import output_dir, write_text
from sfsnet_dr.report.console import bar
from sfsnet_dr.report.record import Record, write_records
from sfsnet_dr.study.evaluate.measure import measure
from sfsnet_dr.study.evaluate.page import write_pages
from sfsnet_dr.study.evaluate.shots import Collection
from sfsnet_dr.study.evaluate.summary import counts_of, records_of
from sfsnet_dr.study.evaluate.tables import csv_text
from sfsnet_dr.study.evaluate.unseen import cross_validated, strangers, unseen


def evaluate(
    collection: Collection, methods: Sequence[Method], out: Path | str, command: str
) -> list[Record]:
    """Measure methods and write ``records.json``, ``table.csv`` and ``index.html``.

    Args:
        collection: the photographs; a network that was fine-tuned on some of the subjects is measured on
            the others only.
        methods: with different names.
        out: folder, made if missing.
        command: for the records.
    """
    folder = output_dir(out)
    records = counts_of(collection, command)
    theirs = {method.name: unseen([method], collection) for method in methods}
    found, names = [], []
    with bar("measuring", sum(len(part.shots) for part in theirs.values())) as advance:
        for method in methods:
            names.append(method.name)

            def on_batch(count: int) -> None:
                for _ in range(count):
                    advance()

            found.append(measure(method, theirs[method.name].shots, on_batch))
            records += records_of(theirs[method.name], found[-1], command)
            apart = strangers(method, found[-1])
            if apart is not None:
                records += records_of(collection, apart, command)
                names.append(apart.method)
    for whole in cross_validated(methods, found):
        records += records_of(collection, whole, command)
        names.append(whole.method)
    write_records(folder / "records.json", records)
    write_text(folder / "table.csv", csv_text(collection.data, names, records))
    write_pages(folder, collection, methods, names, found, records)
    return records
