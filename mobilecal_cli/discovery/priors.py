"""Priors of the robot description's constants, as `priors:` in rig.yaml gives them."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping

from mobilecal_cli.config import PriorEntry
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.nuisance import KINDS, Constant, table
from mobilecal_cli.model import HeadChain, StereoRig

#: Name that stands for all constants.
ALL = "all"


def prior_sigmas(priors: Mapping[str, PriorEntry], cameras: StereoRig, chain: HeadChain) -> dict[str, float]:
    """Name of each constant that the configuration mentions → its prior sigma, see `Rig.prior_sigmas`.

    An entry for one constant overrides that of its kind, which overrides that of all.

    Args:
        priors: "all", a kind or a constant → one standard deviation in the kind's unit for people, "fixed" or "free".
        cameras: the stereo pair.
        chain: the head chain.

    Raises:
        ConfigError: a name that this robot does not have.
    """
    rows = table(cameras, chain)
    _check(priors, rows)
    sigmas = {}
    for row in rows:
        for key in (row.name, row.kind, ALL):
            if key in priors:
                sigmas[row.name] = _sigma(row, priors[key])
                break
    return sigmas


def _sigma(row: Constant, entry: PriorEntry) -> float:
    """Prior sigma in the unit of the code; joints that slide have other units than those that turn."""
    if isinstance(entry, str):
        return {"fixed": 0.0, "free": math.inf}[entry]
    return entry / row.of_kind.shown * (row.sigma / row.of_kind.sigma)


def shown_priors(sigmas: Mapping[str, float], cameras: StereoRig, chain: HeadChain) -> dict[str, PriorEntry]:
    """The inverse of `prior_sigmas`: name → standard deviation in the kind's unit for people, "fixed" or "free"."""
    entries: dict[str, PriorEntry] = {}
    for row in table(cameras, chain):
        sigma = sigmas.get(row.name)
        if sigma is None:
            continue
        shown = float(f"{sigma * row.of_kind.shown * (row.of_kind.sigma / row.sigma):.12g}")
        entries[row.name] = "free" if sigma == math.inf else shown if sigma else "fixed"
    return entries


def _check(priors: Mapping[str, PriorEntry], rows: tuple[Constant, ...]) -> None:
    kinds, names = [kind.name for kind in KINDS], [row.name for row in rows]
    known = [ALL, *kinds, *names]
    for name in priors:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = (
                f"did you mean {near[0]}?"
                if near
                else f"kinds: {', '.join(kinds)}; constants: {', '.join(names)}"
            )
            raise ConfigError(f"priors.{name}: this robot has no such constant", hint)
