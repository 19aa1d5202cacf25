"""Export formats and paper sizes, in a module that imports nothing heavy, for the command line."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from pkgutil import iter_modules


class Target(StrEnum):
    """A format of `mobilecal export`: each is a file in export/formats/."""

    _ignore_ = "_module"
    for _module in iter_modules([str(Path(__file__).parent / "export" / "formats")]):
        vars()[_module.name] = _module.name


class Paper(StrEnum):
    """A page of `mobilecal board`: automatic (A4 to A0), a standard size, or as large as the board needs."""

    auto = "auto"
    a4 = "a4"
    a3 = "a3"
    a2 = "a2"
    a1 = "a1"
    a0 = "a0"
    letter = "letter"
    tabloid = "tabloid"
    ansi_c = "ansi_c"
    ansi_d = "ansi_d"
    ansi_e = "ansi_e"
    exact = "exact"
