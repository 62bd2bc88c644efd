"""One self-contained HTML page: text, pictures and tables, no script, no network.

A page is a title, a lead paragraph and sections; a section is a heading and blocks in the order in which
they are read. A plain string is a paragraph; text between backticks is set as code. Everything is escaped.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from sfsnet_dr.core import files

_CODE = re.compile(r"`([^`]+)`")
#: A sign, a comparison or a plus-minus may stand before the digits; an empty cell or a dash is allowed.
_NUMBER = re.compile(r"[-+\u2212\u00b1<>\u2248~]?\s*\d.*|[-\u2013\u2014]?")
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Figure:
    """A picture with a caption.

    Attributes:
        png: the picture.
        caption: what to see in it.
        alt: what it shows, for those who cannot see it; the caption where empty.
        density: pixels of the picture for one pixel of the page; 2 keeps plots sharp on dense screens.
    """

    png: bytes
    caption: str
    alt: str = ""
    density: int = 2

    kind = "figure"

    @property
    def width(self) -> int:
        """Width on the page, in its pixels, from the PNG's header."""
        return int.from_bytes(self.png[16:20], "big") // self.density


@dataclass(frozen=True)
class Gallery:
    """Small pictures side by side, each with a label; they wrap on a narrow screen."""

    images: Sequence[tuple[bytes, str]]
    caption: str = ""

    kind = "gallery"


@dataclass(frozen=True)
class Table:
    """Rows of text. Columns that hold only numbers are set to the right."""

    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""

    kind = "table"

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headers):
                raise ValueError(f"table row {list(row)!r}: {len(row)} cells, {len(self.headers)} headers")

    def numeric(self, column: int) -> bool:
        """Whether every cell of a column reads as a number."""
        return bool(self.rows) and all(_NUMBER.fullmatch(row[column].strip()) for row in self.rows)


@dataclass(frozen=True)
class KeyNumbers:
    """A few numbers to read first: (value with unit, what it is)."""

    numbers: Sequence[tuple[str, str]]

    kind = "numbers"


@dataclass(frozen=True)
class Note:
    """A sentence that must not be missed, such as a limit of the result."""

    text: str

    kind = "note"


@dataclass(frozen=True)
class Link:
    """A line that leads to another page beside this one."""

    target: str
    text: str

    kind = "link"


Block = str | Figure | Gallery | Table | KeyNumbers | Note | Link


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it, in reading order."""

    heading: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """The section's name in links."""
        return re.sub(r"[^a-z0-9]+", "-", self.heading.lower()).strip("-")


def render_page(title: str, lead: str, sections: Sequence[Section], *, footer: str = "") -> str:
    """The page as HTML text.

    Args:
        title: heading of the page and of the browser's tab.
        lead: a paragraph for newcomers: what this is and what came out.
        sections: what follows; three or more get a line of links on top.
        footer: small print, such as versions and machine.

    Raises:
        ValueError: if a picture is not a PNG or two sections have the same heading.
    """
    anchors = [section.anchor for section in sections]
    if len(set(anchors)) != len(anchors):
        raise ValueError(f"section headings must differ: {anchors}")
    environment = Environment(
        loader=PackageLoader("sfsnet_dr.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"prose": _prose, "data_uri": _data_uri}
    template = environment.get_template("page.html")
    return template.render(title=title, lead=lead, sections=sections, footer=footer)


def write_page(
    path: Path | str, title: str, lead: str, sections: Sequence[Section], *, footer: str = ""
) -> None:
    """Write ``render_page`` as a whole file."""
    files.write_text(path, render_page(title, lead, sections, footer=footer))


def _prose(text: str) -> Markup:
    """Escape a text, then set what stands between backticks as code."""
    return Markup(_CODE.sub(r"<code>\1</code>", str(escape(text))))


def _data_uri(png: bytes) -> str:
    if not png.startswith(_PNG):
        raise ValueError(f"picture: a PNG is needed, {png[:8]!r} found at its start")
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
