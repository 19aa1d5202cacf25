"""The tables of the page. A new table is a function with the decorator `table`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from mobilecal_cli.likelihood.constants import kind_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.rig import SIDES, HeadChain
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.evaluation import EvaluationData, evaluation_tables
from mobilecal_cli.report.formats import Table, like
from mobilecal_cli.report.numbers import DEG, parameters_of, percent_text, reference_std, std_text, value_text
from mobilecal_cli.report.verdict import verdict_of

_Make: TypeAlias = Callable[[Case], Iterator[Table]]
_TABLES: list[_Make] = []
_MOST_REJECTIONS = 100  # further ones are in report.json only
_MOST_CONSTANTS = 6  # that the page lists, if none is contradicted
_DIGITS = 5  # of rad, m and factors, where no standard deviation is known


def table(make: _Make) -> _Make:
    """Add a function to the tables of the page; it yields nothing where there is nothing to show."""
    _TABLES.append(make)
    return make


def tables(case: Case) -> tuple[Table, ...]:
    """All tables that have rows."""
    return tuple(each for make in _TABLES for each in make(case) if each.rows)


@table
def change(case: Case) -> Iterator[Table]:
    """Change of each parameter from the last calibration or the nominal values."""
    difference = case.change
    if difference is None:
        return

    def shown(value: float, digits: int) -> str:
        return f"{value:+.{digits}f}" if np.isfinite(value) else ""

    parameters = parameters_of(case.extraction.rig.sources.assumed_wheels)
    columns = (each.tolist() for each in (difference.value, difference.sigmas, difference.percent))
    rows = [
        (
            p.name,
            value_text(value * p.per_unit, None if std is None else std * p.per_unit, _DIGITS, "+"),
            p.unit,
            shown(sigmas, 1),
            shown(percent, 2),
        )
        for p, std, value, sigmas, percent in zip(
            parameters, reference_std(case.solution), *columns, strict=True
        )
        if np.isfinite(value)
    ]
    over = ", also in standard deviations of the difference" if np.isfinite(difference.sigmas).any() else ""
    note = f"Difference from {difference.against}{over}."
    if difference.p_value is not None:
        chance = percent_text(difference.p_value)
        note += f" If the robot did not change, the probability of a difference this large is {chance}."
    heads = ("name:", "number:change", "unit", "number:in sigma", "number:in %")
    yield Table.of(heads, rows, "limits", "Change", note)


#: Noise level → label, unit, factor.
_LEVELS = {
    "pixel_px": ("corner coordinate", "px", 1.0),
    "wheel_rad_per_sqrt_rad": ("wheel rotation", "rad per √rad", 1.0),
    "encoder_rad": ("encoder reading", "rad", 1.0),
    "joint_rad": ("joint reading", "deg", DEG),
    "floor_rad": ("floor: roll and pitch under the base", "deg", DEG),
    "floor_m": ("floor: height under the base", "mm", 1e3),
    "sway_rad": ("sway: roll and pitch of the base beside the floor's", "deg", DEG),
    "sway_m": ("sway: height of the base beside the floor's", "mm", 1e3),
    "stamp_s": ("image time stamp in motion", "ms", 1e3),
    "pair_s": ("time between the images of two cameras in motion", "ms", 1e3),
    "shift_px": ("shift of an image", "px", 1.0),
    "wheel_share": ("scale of a wheel", "%", 100.0),
    "pose_scale": ("measured poses, over their stated standard deviation", "", 1.0),
}


@table
def noise(case: Case) -> Iterator[Table]:
    """Noise levels, and how each was obtained."""
    if case.solution.uncertainty is None:
        return
    levels, given = case.solution.uncertainty.noise, case.extraction.rig.noise
    chain = case.extraction.rig.chain
    moving = not all(o.at_rest for o in case.extraction.observations)
    seen_moving = {*levels.estimated, *(given if moving else ())}
    rows = []
    for level, (meaning, unit, factor) in _LEVELS.items():
        std = float(getattr(levels, level))
        source = "given" if level in given else "assumed"
        if level in ("stamp_s", "pair_s") and level not in seen_moving:
            continue
        if level == "shift_px" and len(case.extraction.rig.cameras.each) == 1:
            continue
        if level == "encoder_rad" and not std:
            continue
        if level == "joint_rad" and not chain.joints:
            continue
        if level == ("pixel_px" if case.extraction.measured else "pose_scale"):
            continue
        if level in levels.estimated:
            source = "estimated"
        elif level == "encoder_rad":
            source = "from the encoder step"
        kinds = [("", factor, unit)] if level != "joint_rad" else _joint_kinds(chain)
        rows += [(f"{meaning}{kind}", std_text(std * f), shown, source) for kind, f, shown in kinds]
    heads = ("measurement", "number:1 sigma", "unit", "source")
    yield Table.of(heads, rows, "limits", "Measurement noise")


def _joint_kinds(chain: HeadChain) -> list[tuple[str, float, str]]:
    """Kinds of joints of a head: (suffix of the label, factor from units of joint noise, unit for people)."""
    units = dict(zip(chain.joints, chain.joint_units, strict=True))
    both = 0 < len(chain.prismatic) < len(units)
    revolute, prismatic = (", revolute", ", prismatic") if both else ("", "")
    kinds = [(revolute, DEG, "deg")] if len(chain.prismatic) < len(units) else []
    return kinds + [(prismatic, 1e3 * units[name], "mm") for name in sorted(chain.prismatic)[:1]]


@table
def separately(case: Case) -> Iterator[Table]:
    """Each recording's own estimate minus the common one, and the spread between recordings."""
    between, uncertainty = case.solution.between, case.solution.uncertainty
    if between is None or uncertainty is None:
        return
    present = sorted({o.log for o in case.extraction.observations})
    per_unit = [each.per_unit for each in parameters_of(case.extraction.rig.sources.assumed_wheels)]
    without = ["fixed" if by_user else "unobservable" for by_user in uncertainty.fixed]

    rows = [
        (
            f"recording {number + 1}",
            *(
                f"{value_text(s * u, d * u, 5, '+')} ± {std_text(d * u)}" if ok else otherwise
                for u, s, d, ok, otherwise in zip(per_unit, shift, std, shown, without, strict=True)
            ),
        )
        for number, shift, std, shown in zip(present, between.shift, between.std, between.shown, strict=True)
    ]
    compared = between.shown.sum(axis=0) > 1
    spread = (
        std_text(s * u) if ok else otherwise
        for u, s, ok, otherwise in zip(per_unit, between.between_std, compared, without, strict=True)
    )
    rows.append(("spread between recordings", *spread))
    note = "Difference from the common estimate ± 1 sigma, in rad and m; the last row: the spread between recordings."
    heads = ("", *(f"number:{name}" for name in NINE))
    yield Table.of(heads, rows, "limits", "Each recording separately", note)


@table
def constants(case: Case) -> Iterator[Table]:
    """The constants that are contradicted, the clocks, and those that are furthest from their stated values."""
    solution = case.solution
    wrong = {(evidence.kind, evidence.part) for evidence in solution.contradictions}
    bad = {name for name, c in solution.constants.items() if (c.kind, c.part) in wrong}
    always = bad | {name for name, c in solution.constants.items() if c.kind == "clock"}
    off = {name: abs(c.value) / c.prior if c.prior > 0 else 0.0 for name, c in solution.constants.items()}
    rows = []
    for name in sorted(off, key=lambda name: (name not in bad, name not in always, -off[name])):
        constant = solution.constants[name]
        kind, std = kind_of(constant.kind), constant.std * kind_of(constant.kind).shown
        row = (
            name,
            constant.meaning,
            value_text(constant.value * kind.shown, std, 3, "+"),
            std_text(std),
            "fixed" if constant.prior == 0 else std_text(constant.prior * kind.shown),
            kind.shown_unit,
            "contradicts" if name in bad else "",
        )
        rows.append(row)
    note = "Difference from the stated value. params.yaml lists all constants."
    heads = ("name:", "constant", "number:difference", "number:1 sigma", "number:prior", "unit", "tag:")
    shown = rows[: max(len(always), _MOST_CONSTANTS)]
    yield Table.of(heads, shown, "description", "Estimated constants", note)


@table
def checks(case: Case) -> Iterator[Table]:
    """All criteria."""
    rows = [
        ("" if c.outcome == "pass" else c.label, c.name, c.measured_text, c.limit_text)
        for c in verdict_of(case).checks
    ]
    yield Table.of(("tag:", "criterion", "measured", "limit"), rows, "checks")


@table
def each_rejected(case: Case) -> Iterator[Table]:
    """Each rejected station and image."""
    extraction, items = case.extraction, case.extraction.rejections
    rows = [
        (
            np.datetime_as_string(np.datetime64(item.time_ns, "ns"), unit="ms").replace("T", " "),
            "–" if item.station < 0 else extraction.station_name(item.log, item.station),
            item.reason,
            item.detail,
        )
        for item in items[:_MOST_REJECTIONS]
    ]
    more = len(items) - _MOST_REJECTIONS
    rows += [("", "", f"report.json lists {more} more.", "")] if more > 0 else []
    yield Table.of(("time (UTC)", "station", "reason", "details"), rows, "stations", "Not used")


@table
def inputs(case: Case) -> Iterator[Table]:
    """Topics, board, recordings and version."""
    sources, board = case.extraction.rig.sources, case.extraction.board
    elsewhere = (f"{name}: {source.topic} {source.where}" for name, source in sources.elsewhere.items())
    infos = ", ".join(info or "not from the recording" for info in sources.info.values())
    rows = [
        ("images", ", ".join(sources.image.values())),
        ("camera calibration", "" if case.extraction.measured else infos),
        ("head joints", ", ".join((*sources.joint_topics, *elsewhere))),
    ]
    for side in SIDES:
        wheel = sources.wheels[side]
        parts = [f"{wheel.topic} {wheel.where if wheel.joint or wheel.field else ''}"]
        if wheel.ticks_per_revolution is not None:
            parts.append(f"{wheel.ticks_per_revolution:g} ticks per revolution")
        if wheel.sign < 0:
            parts.append("sign reversed")
        rows.append((f"{side} wheel", ", ".join(parts)))
    square_mm = case.extraction.square_m * 1e3
    size = f"stated square size {square_mm:g} mm"
    if board.square_m is None:
        size = f"square size {square_mm:.2f} mm, measured by the stereo pair"
    if not case.extraction.measured:
        rows.append(("board", f"{board.columns} x {board.rows} inner corners, {size}"))
    rows += [(log.path, f"SHA-256 {log.sha256}") for log in case.provenance.logs]
    made = f"mobilecal {case.provenance.version}, method {case.provenance.method}, {case.provenance.created}"
    rows.append(("calibrated", f"{made}; params.yaml lists all settings"))
    yield Table.of(("", "code:"), [row for row in rows if row[1]], "record")


@table
def held_out(case: Case) -> Iterator[Table]:
    """The errors on the held-out stations, and the drift of dead reckoning there."""
    if case.trial is not None:
        yield from evaluation_tables(like(EvaluationData, case.trial))
