"""The page: self-contained, escaped, and complete."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sfsnet_dr.report.html import Figure, Gallery, KeyNumbers, Note, Section, Table, render_page, write_page

VOID = {"meta", "img", "br", "link", "input"}


def png(level: int = 200) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.full((4, 6, 3), level, np.uint8)).save(buffer, format="png")
    return buffer.getvalue()


SECTIONS = [
    Section("Key numbers", [KeyNumbers([("1.2 %", "error on the sphere")]), "Run `make demo` to repeat."]),
    Section(
        "Pictures",
        [Figure(png(), "A <b>caption</b> & more", alt="grey"), Gallery([(png(10), "input"), (png(20), "x")])],
    ),
    Section("Table", [Table(["name", "error"], [["a<b", "1.0 %"], ["c", "≈ 12 %"]]), Note("Minutes only.")]),
]


class Balanced(HTMLParser):
    """Fails where a tag is closed that was not opened last."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def parsed(text: str) -> Balanced:
    parser = Balanced()
    parser.feed(text)
    parser.close()
    assert parser.open == []
    return parser


def test_every_tag_is_closed_and_nothing_is_loaded_from_elsewhere() -> None:
    text = render_page("Title", "Lead.", SECTIONS, footer="small print")
    tags = parsed(text).seen
    assert "script" not in {tag for tag, _ in tags}
    addresses = [a for _, attributes in tags for k, a in attributes.items() if k in ("src", "href") and a]
    assert addresses
    assert all(a.startswith(("data:image/png;base64,", "#")) for a in addresses)
    assert "url(" not in text
    assert "@import" not in text


def test_phones_and_dark_mode_are_provided_for() -> None:
    text = render_page("Title", "Lead.", SECTIONS)
    assert 'name="viewport" content="width=device-width' in text
    assert "prefers-color-scheme: dark" in text


def test_text_is_escaped_and_backticks_are_code() -> None:
    text = render_page("A & B", "Lead <i>.", SECTIONS)
    shown = parsed(text).text
    assert "A <b>caption</b> & more" in shown
    assert "Lead <i>." in shown
    assert "<code>make demo</code>" in text
    assert not re.search(r"<[bi]>", text)


def test_pictures_are_embedded_whole() -> None:
    text = render_page("Title", "Lead.", SECTIONS)
    found = [base64.b64decode(code) for code in re.findall(r"data:image/png;base64,([^\"]+)", text)]
    assert found == [png(), png(10), png(20)]
    images = [attributes for tag, attributes in parsed(text).seen if tag == "img"]
    assert [a["alt"] for a in images] == ["grey", "input", "x"]


def test_links_lead_to_sections() -> None:
    tags = parsed(render_page("Title", "Lead.", SECTIONS)).seen
    links = [a["href"] for tag, a in tags if tag == "a"]
    assert links == ["#key-numbers", "#pictures", "#table"]
    assert [a["id"] for tag, a in tags if tag == "section"] == ["key-numbers", "pictures", "table"]


def test_number_columns_are_set_to_the_right() -> None:
    table = Table(["name", "error", "time"], [["sphere", "-1.5 %", "2 ms"], ["head", "~ 3", "\u2013"]])
    assert [table.numeric(c) for c in range(3)] == [False, True, True]
    tags = parsed(render_page("Title", "Lead.", [Section("T", [table])])).seen
    assert [a.get("class") for tag, a in tags if tag == "td"] == [None, "number", "number"] * 2


def test_wrong_parts_are_refused() -> None:
    with pytest.raises(ValueError, match="PNG is needed"):
        render_page("Title", "Lead.", [Section("S", [Figure(b"JFIF", "no")])])
    with pytest.raises(ValueError, match="2 cells, 1 headers"):
        Table(["one"], [["a", "b"]])
    with pytest.raises(ValueError, match="must differ"):
        render_page("Title", "Lead.", [Section("Same", []), Section("same", [])])


def test_a_page_is_one_file(tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", "Title", "Lead.", SECTIONS)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
