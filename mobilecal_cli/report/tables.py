"""Tables of the section on uncertainty. A new table is a function and a line in `_TABLES`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mobilecal_cli.model import NINE, Extraction, Solution
from mobilecal_cli.report.findings import log_rows, noise_rows, predicted_rows


@dataclass(frozen=True, slots=True)
class Table:
    """A table, formatted.

    Attributes:
        title: heading.
        heads: label of each column, and whether it holds numbers.
        rows: cells.
        note: text above the table.
    """

    title: str
    heads: tuple[tuple[str, bool], ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def _noise(solution: Solution, extraction: Extraction) -> Table:
    heads = (("measurement", False), ("1 sigma", True), ("unit", False), ("source", False))
    rows = noise_rows(solution, extraction)
    return Table("Measurement noise", heads, tuple((r.meaning, r.std, r.unit, r.value) for r in rows))


def _in_use(solution: Solution, _: Extraction) -> Table:
    heads = (("quantity", False), ("1 sigma", True), ("default limit", True), ("unit", False))
    rows = tuple((r.meaning, r.std, r.value or "–", r.unit) for r in predicted_rows(solution))
    return Table("Expected errors in use", heads, rows)


def _logs(solution: Solution, extraction: Extraction) -> Table:
    note = (
        "Difference of the estimate from each recording alone from the common estimate, ± 1 sigma, in deg and mm. The "
        "last row is the spread between recordings that these standard deviations do not explain. The standard "
        "deviations above include it."
    )
    rows = tuple((name, *cells) for name, cells in log_rows(solution, extraction))
    return Table("Each recording separately", (("", False), *((name, True) for name in NINE)), rows, note)


_TABLES: tuple[Callable[[Solution, Extraction], Table], ...] = (_noise, _in_use, _logs)


def tables(solution: Solution, extraction: Extraction) -> tuple[Table, ...]:
    """All tables that have rows."""
    made = (make(solution, extraction) for make in _TABLES)
    return tuple(table for table in made if table.rows)
