"""A PDF of one page with filled rectangles and lines of text, at true scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mobilecal_cli.model import FloatArray

#: Width of a character of the font, in shares of its size.
CHARACTER = 0.6
POINTS_PER_MM = 72 / 25.4
#: Largest side of a page that readers accept: 14,400 points.
LARGEST_MM = 14_400 / POINTS_PER_MM


@dataclass(frozen=True, slots=True)
class Line:
    """A line of text in Courier.

    Attributes:
        text: ASCII.
        x_mm, y_mm: start of the baseline, from the top left corner of the page.
        size_mm: font size.
    """

    text: str
    x_mm: float
    y_mm: float
    size_mm: float


def one_page(
    width_mm: float, height_mm: float, rectangles_mm: FloatArray, lines: Sequence[Line], title: str
) -> bytes:
    """A PDF of one page. It asks the reader to print without scaling.

    Args:
        width_mm, height_mm: size of the page, at most `LARGEST_MM`.
        rectangles_mm: (n, 4) x and y of the top left corner from that of the page, width and height. They are filled
            in black as one path, so that adjacent ones have no seam.
        lines: text.
        title: title of the document, ASCII.
    """
    scale = _number(POINTS_PER_MM)
    drawing = [f"{scale} 0 0 -{scale} 0 {_number(height_mm * POINTS_PER_MM)} cm"]  # y down
    drawing += [" ".join(_number(value) for value in row) + " re" for row in rectangles_mm]
    drawing += ["f" if len(rectangles_mm) else "", "BT"]
    for line in lines:
        place = f"1 0 0 -1 {_number(line.x_mm)} {_number(line.y_mm)} Tm"
        drawing.append(f"/F {_number(line.size_mm)} Tf {place} {_text(line.text)} Tj")
    content = "\n".join([*drawing, "ET"]).encode("ascii")
    box = f"[0 0 {_number(width_mm * POINTS_PER_MM)} {_number(height_mm * POINTS_PER_MM)}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Courier /Encoding /WinAnsiEncoding >>",
        f"<< /Title {_text(title)} /Producer (mobilecal) >>".encode("ascii"),
    ]
    return _file(objects)


def _file(objects: Sequence[bytes]) -> bytes:
    """Header, numbered objects, table of their positions, trailer; the first is the catalog, the last the info."""
    out = bytearray(b"%PDF-1.6\n%\xe2\xe3\xcf\xd3\n")  # bytes above 127: not a text file
    positions = []
    for number, body in enumerate(objects, 1):
        positions.append(len(out))
        out += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table, count = len(out), len(objects) + 1
    out += b"xref\n0 %d\n0000000000 65535 f \n" % count
    out += b"".join(b"%010d 00000 n \n" % position for position in positions)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (count, len(objects))
    return bytes(out + b"startxref\n%d\n%%%%EOF\n" % table)


def _number(value: float) -> str:
    """Up to six decimals, without an exponent, which PDF does not have."""
    return f"{value:.6f}".rstrip("0").rstrip(".")


def _text(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    return f"({escaped})"
