"""Messages on the leaf pages of an SQLite file, whether or not other pages lead there.

A table's rows are on leaf pages; interior pages lead to these. A database that grows gets interior pages late, at its
end: a file that is cut has all leaves before the cut, and nothing that leads to them. The format:
https://www.sqlite.org/fileformat2.html, sections 1.5, 1.6 and 2.1.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO, NamedTuple

import numpy as np

from mobilecal_cli.readers.messages import SIZE_LIMIT

_LEAF = 13
_PAGE_BYTES, _RESERVED = slice(16, 18), 20  # places in the header of a file
_HEAD = struct.Struct(">BxxH")  # of a page: its kind, and the number of its rows
_MOST_ROWS = 2**48  # larger numbers of rows are damage
_BLOB = 12  # types of values from this on are data, or text
#: Type of an integer → its bytes; two types are those of 0 and 1.
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
#: Further pages of all rows, as a multiple of the file's; more are those of rows that share pages, made to take time.
_MOST_SHARED = 10
#: What a damaged row raises.
_DAMAGE = (IndexError, KeyError, ValueError)


class LeafRow(NamedTuple):
    """A row (id, topic_id, timestamp, data) of a table of messages.

    Attributes:
        row: its number.
        channel: id of the topic.
        log_ns: its time.
        size: bytes of its data.
        begin, end: where the data on the leaf is in the file; if there is more, the next 4 bytes name a page.
    """

    row: int
    channel: int
    log_ns: int
    size: int
    begin: int
    end: int


class LeafPages:
    """An SQLite file that is read page by page.

    Attributes:
        rows: (n, 6) those whose pages are all in the file, as `LeafRow`, by their numbers.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._file = stream.fileno()
        header = self._read(0, 100)
        self._size = int.from_bytes(header[_PAGE_BYTES])
        self._size = 65536 if self._size == 1 else self._size
        self._usable = self._size - header[_RESERVED]
        self._end = os.fstat(self._file).st_size
        self._most_further = _MOST_SHARED * self._end // self._size
        whole = array("q")
        for begin in range(0, self._end, self._size):
            for row in self._rows_on(begin):
                if self._is_whole(row):
                    whole.extend(row)
        every = np.array(whole, dtype=np.int64).reshape(-1, len(LeafRow._fields))
        self.rows = every[np.unique(every[:, 0], return_index=True)[1]]

    def _read(self, begin: int, end: int) -> bytes:
        return os.pread(self._file, end - begin, begin)

    def data(self, number: int) -> bytes | None:
        """Data of a row, None if it is not there."""
        place = int(np.searchsorted(self.rows[:, 0], number))
        if place == len(self.rows) or self.rows[place, 0] != number:
            return None
        row = LeafRow(*self.rows[place].tolist())
        pieces, left = [self._read(row.begin, row.end)], row.size - (row.end - row.begin)
        for page in self._further_pages(row):
            pieces.append(self._read(page + 4, page + min(left + 4, self._usable)))
            left -= len(pieces[-1])
        return b"".join(pieces)

    def _is_whole(self, row: LeafRow) -> bool:
        """Whether all pages of a row are in the file."""
        for page in self._further_pages(row):
            self._most_further -= 1
            if not 0 <= page <= self._end - self._size or self._most_further < 0:
                return False
        return True

    def _further_pages(self, row: LeafRow) -> Iterator[int]:
        """Where the pages begin that continue a row."""
        at, left = row.end, row.size - (row.end - row.begin)
        for _ in range(-(-left // (self._usable - 4))):
            at = (int.from_bytes(self._read(at, at + 4)) - 1) * self._size
            yield at

    def _rows_on(self, begin: int) -> Iterator[LeafRow]:
        """Messages on a leaf page that begins at a byte of the file; none on another table's."""
        page = self._read(begin, begin + self._size)
        with suppress(struct.error):  # the page is cut, or its number of rows is damaged
            kind, count = _HEAD.unpack_from(page)
            if kind != _LEAF:
                return
            for at in struct.unpack_from(f">{count}H", page, 8):
                with suppress(*_DAMAGE):
                    yield self._row(page, at, begin)

    def _row(self, page: bytes, at: int, begin: int) -> LeafRow:
        """The row at a place of a page.

        Raises:
            Exception: see `_DAMAGE`; or it is no message.
        """
        size, at = _number(page, at)
        row, record = _number(page, at)
        head, at = _number(page, record)
        types = []
        for _ in range(4):
            kind, at = _number(page, at)
            types.append(kind)
        of_row, topic, time, data = types
        at = record + head
        channel, at = _integer(page, at, topic)
        log_ns, at = _integer(page, at, time)
        length = record + size - at
        end = record + self._on_leaf(size)
        is_message = of_row == 0 and data >= _BLOB and length == (data - _BLOB) // 2
        if not (is_message and 0 < row < _MOST_ROWS and length <= SIZE_LIMIT and at <= end <= len(page)):
            raise ValueError("not a message")
        return LeafRow(row, channel, log_ns, length, begin + at, begin + end)

    def _on_leaf(self, size: int) -> int:
        """Bytes of a record that are on its leaf."""
        least, most = (self._usable - 12) * 32 // 255 - 23, self._usable - 35
        if size <= most:
            return size
        here = least + (size - least) % (self._usable - 4)
        return here if here <= most else least


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


def _integer(page: bytes, at: int, kind: int) -> tuple[int, int]:
    """An integer of a type at a place of a page, and the place after it."""
    end = at + _INTEGERS[kind]
    return (int.from_bytes(page[at:end], signed=True) if end > at else kind - 8), end
