"""The tree of an SQLite table, made again from its leaves, where the pages above them are lost.

A table's rows are on leaf pages; interior pages lead to these. A database that grows gets interior pages late, at its
end: a file that is cut has all leaves before the cut, and nothing that leads to them. The format:
https://www.sqlite.org/fileformat2.html, sections 1.5 and 1.6.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

_LEAF, _INTERIOR = 13, 5
_PAGE_BYTES, _RESERVED, _PAGES = slice(16, 18), 20, 28  # places in the header of a file
_CELLS = struct.Struct(">xxxH")  # of a page: their number
_HEAD_OF_LEAF = struct.Struct(">BHH")  # type, no free block, cells
# Type, no free block, cells, begin of the cells, no fragments, last child.
_INTERIOR_HEAD = struct.Struct(">BHHHBI")
_LONGEST_CELL = 4 + 9 + 2  # bytes of a child, its largest row number, and a pointer
_MOST_ROWS = 2**48  # larger numbers of rows are damage
_BLOB = 12  # from this serial type on, even numbers; integers have smaller ones
#: What reading beyond the end of a page raises.
_DAMAGE = (IndexError, struct.error)


class Leaf(NamedTuple):
    """A leaf page.

    Attributes:
        last_row: its largest row number.
        page: its number, from 1 on.
        rows: on it.
    """

    last_row: int
    page: int
    rows: int


def message_leaves(path: Path) -> tuple[list[Leaf], bool]:
    """Leaves with rows of a table of messages (id, topic_id, timestamp, data), and whether the file ends within a page.

    The leaves are in the order of their rows, the last one without rows whose further pages are not in the file.
    """
    content = np.memmap(path, dtype=np.uint8, mode="r")
    head = bytes(content[:100])
    size, usable = _page_bytes(head), _page_bytes(head) - head[_RESERVED]
    pages = content[: len(content) // size * size].reshape(-1, size)
    found: dict[int, Leaf] = {}
    for number in (np.flatnonzero(pages[:, 0] == _LEAF) + 1).tolist():
        leaf = _leaf(bytes(pages[number - 1]), number)
        if leaf is not None:
            found[leaf.last_row] = leaf
    leaves, cut = [found[row] for row in sorted(found)], len(content) % size > 0
    while leaves:
        last = leaves.pop()
        page = bytes(pages[last.page - 1])
        for rows in range(last.rows, 0, -1):
            with suppress(*_DAMAGE):
                cell = _cell(page, rows - 1)
                if _is_whole(cell, page, pages, usable):
                    return [*leaves, Leaf(cell.row, last.page, rows)], cut
    return leaves, cut


def _is_whole(cell: _Cell, page: bytes, pages: NDArray[np.uint8], usable: int) -> bool:
    """Whether all pages that continue a cell are there."""
    least, most = (usable - 12) * 32 // 255 - 23, usable - 35
    if cell.size <= most:
        return True
    here = least + (cell.size - least) % (usable - 4)
    here = here if here <= most else least
    count = -(-(cell.size - here) // (usable - 4))
    further = page[cell.at + here : cell.at + here + 4]
    for _ in range(min(count, len(pages))):
        number = int.from_bytes(further)
        if not 0 < number <= len(pages):
            return False
        further = bytes(pages[number - 1, :4])
    return count <= len(pages)


def link(path: Path, root: int, leaves: Sequence[Leaf]) -> None:
    """Change a file: a table's root page leads to given leaves, by interior pages at its end.

    Args:
        path: an SQLite file.
        root: number of the table's root page.
        leaves: at least one, with increasing rows.
    """
    with path.open("r+b") as stream:
        header = stream.read(100)
        size = _page_bytes(header)
        most = (size - header[_RESERVED] - _INTERIOR_HEAD.size) // _LONGEST_CELL
        last = leaves[-1]
        stream.seek((last.page - 1) * size)
        stream.write(_HEAD_OF_LEAF.pack(_LEAF, 0, last.rows))
        end = -(-path.stat().st_size // size)
        level = [(leaf.page, leaf.last_row) for leaf in leaves]
        while len(level) > most:
            above = []
            for at in range(0, len(level), most):
                children = level[at : at + most]
                end += 1
                _write(stream, end, _interior(children, size, header[_RESERVED]), size)
                above.append((end, children[-1][1]))
            level = above
        _write(stream, root, _interior(level, size, header[_RESERVED]), size)
        stream.seek(_PAGES)
        stream.write(struct.pack(">I", end))
        stream.truncate(end * size)


def _write(stream: BinaryIO, number: int, page: bytes, size: int) -> None:
    stream.seek((number - 1) * size)
    stream.write(page)


def _page_bytes(header: bytes) -> int:
    size = int.from_bytes(header[_PAGE_BYTES])
    return 65536 if size == 1 else size


class _Cell(NamedTuple):
    """A cell on a leaf: its row number, the bytes of its record, and where this begins on the page."""

    row: int
    size: int
    at: int


def _leaf(page: bytes, number: int) -> Leaf | None:
    """A leaf whose first and last rows are messages; None for any other page, or a damaged one."""
    (rows,) = _CELLS.unpack_from(page)
    try:
        ends = [_cell(page, place) for place in (0, rows - 1)]
        are_messages = rows and all(_is_message(page, cell.at) for cell in ends)
    except _DAMAGE:
        return None
    return Leaf(ends[-1].row, number, rows) if are_messages and ends[-1].row < _MOST_ROWS else None


def _cell(page: bytes, place: int) -> _Cell:
    (at,) = struct.unpack_from(">H", page, 8 + 2 * place)
    size, at = _number(page, at)
    row, at = _number(page, at)
    return _Cell(row, size, at)


def _is_message(page: bytes, at: int) -> bool:
    """Whether the record at a place of a page has the row's number, two integers and data."""
    _, at = _number(page, at)  # bytes of its head
    types = []
    for _ in range(4):
        kind, at = _number(page, at)
        types.append(kind)
    of_row, topic, time, data = types
    return of_row == 0 and 0 < topic < _BLOB and 0 < time < _BLOB and data >= _BLOB


def _number(page: bytes, at: int) -> tuple[int, int]:
    """A number of 1 to 9 bytes at a place of a page, and the place after it."""
    value = 0
    for _ in range(8):
        byte = page[at]
        at += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at
    return value << 8 | page[at], at + 1


def _as_number(value: int) -> bytes:
    """The same for a value below 2**56."""
    groups = [value & 0x7F]
    while value := value >> 7:
        groups.append(0x80 | value & 0x7F)
    return bytes(groups[::-1])


def _interior(children: Sequence[tuple[int, int]], size: int, reserved: int) -> bytes:
    """An interior page; children: page number and largest row number of each."""
    *others, (last, _) = children
    cells = [struct.pack(">I", page) + _as_number(row) for page, row in others]
    page, at, pointers = bytearray(size), size - reserved, []
    for cell in cells:
        at -= len(cell)
        page[at : at + len(cell)] = cell
        pointers.append(at)
    head = _INTERIOR_HEAD.pack(_INTERIOR, 0, len(cells), at, 0, last) + struct.pack(
        f">{len(cells)}H", *pointers
    )
    page[: len(head)] = head
    return bytes(page)
