"""What ``sfsnet-dr bench synth`` measured, as a plot and a page. Reads records alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from sfsnet_dr.base.atomic import atomic_path, output_dir
from sfsnet_dr.report.html import Figure, KeyNumbers, Section, Table, write_page
from sfsnet_dr.report.noise_figure import noise_plot
from sfsnet_dr.report.record import Record, write_records

#: Names of the samplers on the plot.
_SAMPLERS = {"sobol": "Sobol", "r4": "R4", "stratified": "stratified", "independent": "random"}


def write_bench(out: Path | str, records: Sequence[Record]) -> None:
    """Write ``records.json``, ``noise.png`` and ``index.html`` into a folder."""
    folder = output_dir(out)
    value = {record.what.removeprefix("synth."): record.value for record in records}
    plot = noise_plot(_lines(value), label="relative noise")
    write_records(folder / "records.json", records)
    with atomic_path(folder / "noise.png") as partial:
        partial.write_bytes(plot)
    lead = (
        f"{value['bundles_per_s']:.2f} complete faces a second; their light transport "
        f"{value['ratio.plain']:.0f} times as fast as one render for each light at the same noise."
    )
    caption = (
        "Noise of the transport against the time of one face's whole transport, for several samplers and "
        "numbers of camera rays a pixel. Down and to the left is better. Noise is relative to the image that "
        "a white sky gives. The point that stands alone: one render for each light, with as many paths as "
        "the scene asks for."
    )
    numbers = [
        (f"{value['bundles_per_s']:.2f} /s", "complete bundles"),
        (f"{value['ratio.plain']:.0f} x", "faster than one render a light, at the same noise"),
        (f"{value['ratio.plain_same_paths']:.0f} x", "the same, at the same number of paths"),
        (f"{100 * value['share.ray_rate']:.0f} %", "of the rate of a bare loop of ray tests"),
    ]
    sections = [
        Section("Speed", [KeyNumbers(numbers), _bundle_table(value), _capture_table(value)]),
        Section("Noise against time", [Figure(plot, caption)]),
    ]
    footer = ", ".join(f"{name} {version}" for name, version in records[0].versions.items())
    write_page(folder / "index.html", "How fast faces are rendered", lead, sections, footer=footer)


def _lines(value: Mapping[str, float]) -> dict[str, list[tuple[float, float, str]]]:
    """Seconds, noise and camera rays a pixel of every sampler, and of the plain way."""
    lines = {}
    for sampler, name in _SAMPLERS.items():
        counts = [key.rsplit(".", 1)[1] for key in value if key.startswith(f"noise.transport.{sampler}.")]
        keys = [f"{sampler}.{count}" for count in counts]
        lines[name] = [
            (
                value[f"seconds.capture.{key}"],
                value[f"noise.transport.{key}"],
                count if sampler == "sobol" else "",
            )
            for key, count in zip(keys, counts, strict=True)
        ]
    plain = (value["seconds.plain.same_paths"], value["noise.transport.plain"], "")
    return lines | {"one render for each light": [plain]}


def _bundle_table(value: Mapping[str, float]) -> Table:
    parts = {
        "sample the face": value["seconds.sample_face"],
        "put its mesh into the scene": value["seconds.exchange_mesh"],
        "maps and transport": value["seconds.capture"],
        "write the file": value["seconds.write_file"],
    }
    whole = value["seconds.bundle"]
    parts["path-traced reference and the rest"] = whole - sum(parts.values())
    return _times("part of a bundle", parts | {"whole": whole}, "Where the time of one face goes.")


def _capture_table(value: Mapping[str, float]) -> Table:
    rays, kernel = value["seconds.rays_at_the_limit"], value["seconds.kernel.paths"]
    parts = {
        "its rays, as fast as bare ray tests": rays,
        "the rest of that kernel: points, BSDF, sums": kernel - rays,
        "kernel that looks where the face is": value["seconds.kernel.coverage"],
        "outside of kernels": value["seconds.outside_kernels"],
    }
    caption = "Where the time of the transport goes, by the history of kernels."
    return _times("part of the transport", parts | {"whole": sum(parts.values())}, caption)


def _times(header: str, parts: Mapping[str, float], caption: str) -> Table:
    rows = [
        [name, f"{1e3 * seconds:.0f}", f"{100 * seconds / parts['whole']:.0f}"]
        for name, seconds in parts.items()
    ]
    return Table([header, "ms", "%"], rows, caption)
