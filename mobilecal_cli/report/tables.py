"""The tables of the page. A new table is a function with the decorator `table`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import NINE, SIDES, HeadChain, Setting
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.evaluation import drift_rows, evaluation_data, evaluation_rows
from mobilecal_cli.report.formats import Table
from mobilecal_cli.report.numbers import (
    Parameter,
    odometry_factors,
    parameters_of,
    reference_pose,
    reference_std,
    rejected_station,
    rejection_counts,
    rotation_std_deg,
    shown_lengths,
    square_size_mm,
    stated_priors,
    std_text,
    value_text,
)
from mobilecal_cli.report.use import FIGURES
from mobilecal_cli.report.verdict import Case
from mobilecal_cli.se3 import log_so3

Rows = Sequence[tuple[str, ...]]
_TABLES: list[Callable[[Case], Table]] = []
_MOST_REJECTIONS = 200  # further ones are in report.json only
_NAMED_SIGMAS = 2.0  # constants that are further from their stated values are tagged


def table(
    section: str, title: str, *heads: str, note: str = ""
) -> Callable[[Callable[[Case], Rows]], Callable[[Case], Rows]]:
    """Make the rows that a function returns a table of the page; see `Table.of` for the arguments."""

    def registered(rows: Callable[[Case], Rows]) -> Callable[[Case], Rows]:
        _TABLES.append(lambda case: Table.of(heads, rows(case), section, title, note).without_empty_columns())
        return rows

    return registered


def tables(case: Case) -> tuple[Table, ...]:
    """All tables that have rows; columns without any text are left out."""
    return tuple(made for made in (make(case) for make in _TABLES) if made.rows)


@table("parameters", "", "parameter", "number:linear", "strong:refined", "number:1 sigma", "unit")
def nine(case: Case) -> Rows:
    """Rotation vector, translation and wheels of both solutions, and the point error."""
    solution, cameras, rig = case.solution, case.solution.cameras, case.extraction.rig
    shown = parameters_of(rig)
    stds, (vector_std, _) = _shown_std(case), rotation_std_deg(solution)
    unknown = ["fixed" if s is None else "–" for s in stds]  # "–": another part of the rotation is fixed
    stds[:3] = [None] * 3 if vector_std is None else vector_std.tolist()
    if solution.uncertainty is None:
        unknown = [""] * 9
    linear, refined = (
        [*np.degrees(log_so3(reference_pose(p, cameras)[:3, :3])), *shown_lengths(p, cameras, shown)]
        for p in (solution.linear.parameters, solution.parameters)
    )
    both = solution.refinement is not None
    rows = [
        (
            p.label,
            value_text(before, s, p.digits),
            value_text(after, s, p.digits) if both else "",
            instead if s is None else std_text(s),
            p.shown_unit,
        )
        for p, before, after, s, instead in zip(shown, linear, refined, stds, unknown, strict=True)
    ]
    errors = (solution.linear.point_rms_m, solution.point_rms_m)
    scales = list(odometry_factors(rig, solution).items())[3:]
    rows += [
        (
            name.replace("_", " "),
            "",
            value_text(value, s, 5),
            "" if s is None else std_text(s) if s else "fixed",
            "factor",
        )
        for name, (value, s) in scales
    ]
    return [
        *rows,
        ("point error", f"{errors[0] * 1e3:.2f}", f"{errors[1] * 1e3:.2f}" if both else "", "", "mm"),
    ]


def _shown_std(case: Case) -> list[float | None]:
    """Nine standard deviations in deg and mm; None where the parameter is fixed or there are none."""
    std, shown = reference_std(case.solution) or (None,) * 9, parameters_of(case.extraction.rig)
    of_factors = odometry_factors(case.extraction.rig, case.solution)
    return [
        None if s is None else of_factors[p.factor_name][1] if p.factor_name else s * p.factor
        for s, p in zip(std, shown, strict=True)
    ]


@table(
    "sigmas", "", "name:", "parameter", "number:1 sigma", "number:change", "unit", "number:change in sigma",
    "number:change in %",
)  # fmt: skip
def sigmas(case: Case) -> Rows:
    """Standard deviation and change of each parameter."""
    found, change = case.solution.uncertainty, case.change
    if found is None:
        return ()

    def shown(value: float, digits: int, std: float | None = None) -> str:
        return value_text(value, std, digits, "+") if np.isfinite(value) else "–"

    rows = []
    for k, (p, s) in enumerate(zip(parameters_of(case.extraction.rig), _shown_std(case), strict=True)):
        how = " (from the robot description)" if found.described[k] else " (unobservable)"
        std = "fixed" if s is None else std_text(s) + ("" if found.observable[k] else how)
        cells = ["", "", ""]
        if change is not None:
            cells = ["–"] * 3
            if s is not None:
                cells = [
                    shown(change.value[k] * p.factor, 3, s), shown(change.sigmas[k], 1), shown(change.percent[k], 2)
                ]  # fmt: skip
            known = (True, np.isfinite(change.sigmas).any(), np.isfinite(change.percent).any())
            cells = [cell if ok else "" for cell, ok in zip(cells, known, strict=True)]
        rows.append((p.factor_name or p.name, p.meaning, std, cells[0], p.shown_unit, cells[1], cells[2]))
    return rows


#: Noise level → label, unit, factor.
_LEVELS = {
    "pixel_px": ("corner coordinate", "px", 1.0),
    "wheel_rad_per_sqrt_rad": ("wheel rotation", "rad per √rad", 1.0),
    "encoder_rad": ("encoder reading", "rad", 1.0),
    "joint_rad": ("joint reading", "deg", 180 / math.pi),
    "floor_rad": ("floor: roll and pitch under the base", "deg", 180 / math.pi),
    "floor_m": ("floor: height under the base", "mm", 1e3),
    "sway_rad": ("sway: roll and pitch of the base beside the floor's", "deg", 180 / math.pi),
    "sway_m": ("sway: height of the base beside the floor's", "mm", 1e3),
    "stamp_s": ("image time stamp in motion", "ms", 1e3),
    "wheel_share": ("scale of a wheel", "%", 100.0),
    "pose_scale": ("measured poses, over their stated standard deviation", "", 1.0),
}


@table("uncertainty", "Measurement noise", "measurement", "number:1 sigma", "unit", "source")
def noise(case: Case) -> Rows:
    """Noise levels, and how each was obtained."""
    if case.solution.uncertainty is None:
        return ()
    levels, given = case.solution.uncertainty.noise, case.extraction.rig.noise.given
    moving = not all(o.at_rest for o in case.extraction.observations)
    rows = []
    for level, (meaning, unit, factor) in _LEVELS.items():
        std = float(getattr(levels, level))
        source = "given" if level in given else "assumed"
        if (level == "stamp_s" and not moving) or (level == "encoder_rad" and not std):
            continue
        if level == ("pixel_px" if case.extraction.measured else "pose_scale"):
            continue
        if level in levels.estimated:
            source = f"estimated from {levels.redundancy[level]:.0f} redundant residuals"
        elif level == "encoder_rad":
            source = "given, or derived from the encoder step"
        kinds = [("", factor, unit)] if level != "joint_rad" else _joint_kinds(case.extraction.rig.chain)
        rows += [(f"{meaning}{kind}", std_text(std * f), shown, source) for kind, f, shown in kinds]
    return rows


def _joint_kinds(chain: HeadChain) -> list[tuple[str, float, str]]:
    """Kinds of joints of a head: (suffix of the label, factor from units of joint noise, unit for people)."""
    units = dict(zip(chain.joints, chain.joint_units, strict=True))
    both = 0 < len(chain.prismatic) < len(units)
    revolute, prismatic = (", revolute", ", prismatic") if both else ("", "")
    kinds = [(revolute, 180 / math.pi, "deg")] if len(chain.prismatic) < len(units) or not units else []
    return kinds + [(prismatic, 1e3 * units[name], "mm") for name in sorted(chain.prismatic)[:1]]


@table("uncertainty", "Expected errors in use", "quantity", "number:1 sigma", "number:default limit", "unit")
def in_use(case: Case) -> Rows:
    """Expected errors of a robot in use."""
    found = case.solution.uncertainty
    return () if found is None else [
        (f.meaning, std_text(f.of(found.at_work)), "–" if f.limit is None else f"{f.limit:g}", f.unit)
        for f in FIGURES
    ]  # fmt: skip


@table(
    "uncertainty", "Each recording separately", "", *(f"number:{name}" for name in NINE),
    note="Difference of the estimate from each recording alone from the common estimate, ± 1 sigma, in deg and mm. "
    "The last row is the spread between recordings that these standard deviations do not explain. The standard "
    "deviations above include it.",
)  # fmt: skip
def separately(case: Case) -> Rows:
    """Each recording's own estimate minus the common one, and the spread between recordings."""
    between, found = case.solution.between, case.solution.uncertainty
    if between is None or found is None:
        return ()
    present = sorted({o.log for o in case.extraction.observations})
    nine = parameters_of(case.extraction.rig)
    without = ["fixed" if by_user else "unobservable" for by_user in found.fixed]

    def one(p: Parameter, shift: float, std: float) -> str:
        return f"{value_text(shift * p.factor, std * p.factor, 3, '+')} ± {std_text(std * p.factor)}"

    rows = [
        (
            f"recording {number}",
            *(
                one(p, s, d) if ok else otherwise
                for p, s, d, ok, otherwise in zip(nine, shift, std, shown, without, strict=True)
            ),
        )
        for number, shift, std, shown in zip(present, between.shift, between.std, between.shown, strict=True)
    ]
    compared = between.shown.sum(axis=0) > 1
    spread = (
        std_text(s * p.factor) if ok else otherwise
        for p, s, ok, otherwise in zip(nine, between.between_std, compared, without, strict=True)
    )
    return [*rows, ("spread between recordings", *spread)]


@table(
    "constants", "", "part", "name:", "constant", "number:difference", "number:1 sigma", "number:prior", "unit", "tag:"
)  # fmt: skip
def constants(case: Case) -> Rows:
    """All constants by part of the robot; those that are far off first."""
    solution, stated = case.solution, stated_priors(case.solution)
    wrong = {(found.kind, found.part) for found in solution.contradictions}
    groups: dict[str, list[tuple[float, tuple[str, ...]]]] = {}
    for found in solution.constants.values():
        kind, prior = nuisance.kind(found.kind), stated.get(found.name, found.prior)
        off = abs(found.value) / prior if prior > 0 else 0.0
        free = found.name == "square_scale" and case.extraction.board.square_m is None
        bad = (found.kind, found.part) in wrong
        std, part = found.std * kind.shown, visible(found.part)
        row = (
            part,
            found.name,
            found.meaning,
            value_text(found.value * kind.shown, std, 3, "+"),
            std_text(std),
            "not stated" if free else "fixed" if prior == 0 else std_text(prior * kind.shown),
            kind.shown_unit,
            "contradicts" if bad else f"beyond {_NAMED_SIGMAS:g} sigma" if off > _NAMED_SIGMAS else "",
        )
        groups.setdefault(part, []).append((-off - 1e6 * bad if row[-1] else 0.0, row))
    ordered = sorted(groups.values(), key=lambda rows: min(rank for rank, _ in rows))
    return [row for rows in ordered for _, row in sorted(rows, key=lambda pair: pair[0])]


@table("hold_out", "", "prediction error on a leg", "number:rms", "number:median", "number:worst", "unit")
def prediction(case: Case) -> Rows:
    """Errors on the held-out stations."""
    return () if case.trial is None else evaluation_rows(evaluation_data(case.trial))


@table("hold_out", "", "drift", "number:nominal wheels", "number:calibrated wheels", "unit")
def drift(case: Case) -> Rows:
    """Drift of dead reckoning between the held-out stations."""
    return () if case.trial is None else drift_rows(evaluation_data(case.trial))


_EXTENT = {
    "pan_range_deg": "pan range of the head [deg]",
    "tilt_range_deg": "tilt range of the head [deg]",
    "turned_deg": "total rotation of the base [deg]",
    "largest_turn_deg": "largest rotation on one leg [deg]",
    "driven_m": "distance driven [m]",
}
_COUNTS = {
    "stations": "stations found",
    "stations_at_rest": "stations at rest in the recording",
    "pictures": "images searched",
    "observations": "stations with the board in the recording",
}


@table("motion", "Motion", "", "number:")
def motion(case: Case) -> Rows:
    """Extent of the motion, and what was found."""
    extent = [
        (_EXTENT.get(key, key), f"{value:.2f}" if key == "driven_m" else f"{value:.1f}")
        for key, value in case.solution.motion.items()
    ]
    return extent + [(_COUNTS.get(key, key), str(n)) for key, n in case.extraction.counts.items()]


@table("checks", "", "tag:result", "criterion", "measured", "limit")
def checks(case: Case) -> Rows:
    """All criteria."""
    return [(c.label, c.name, c.measured_text, c.limit_text) for c in case.verdict.checks]


@table("rejections", "", "reason", "stage", "number:count")
def rejected(case: Case) -> Rows:
    """How often each reason occurred."""
    counts = rejection_counts(case.extraction).items()
    return [(reason, stage, str(count)) for (stage, reason), count in counts]


@table("rejected", "", "time (UTC)", "station", "reason", "details")
def each_rejected(case: Case) -> Rows:
    """Each rejected station and image."""
    items = case.extraction.rejections
    rows = [
        (_moment(item.time_ns), rejected_station(item, case.extraction) or "–", item.reason, item.detail)
        for item in items[:_MOST_REJECTIONS]
    ]
    more = len(items) - _MOST_REJECTIONS
    return [*rows, *([("", "", f"report.json lists {more} more.", "")] if more > 0 else [])]


def _moment(time_ns: int) -> str:
    """A recording's time as a UTC date, or in seconds if it is not a valid date."""
    if 0 < time_ns < 253_402_300_800_000_000_000:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=time_ns // 1000)
        return moment.strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
    return f"{time_ns / 1e9:.3f} s"


@table("input", "", "", "code:")
def inputs(case: Case) -> Rows:
    """Topics and board."""
    sources, board = case.extraction.rig.sources, case.extraction.board
    elsewhere = (f"{name}: {source.topic} {source.where}" for name, source in sources.elsewhere.items())
    rows = [
        ("images", ", ".join(sources.image.values())),
        ("camera calibration", ", ".join(info or "not from the recording" for info in sources.info.values())),
        ("head joints", ", ".join((*sources.joints, *elsewhere))),
    ]
    for side in SIDES:
        wheel = sources.wheels[side]
        parts = [f"{wheel.topic} {wheel.where if wheel.joint or wheel.field else ''}"]
        if wheel.ticks_per_revolution is not None:
            parts.append(f"{wheel.ticks_per_revolution:g} ticks per revolution")
        if wheel.sign < 0:
            parts.append("sign reversed")
        rows.append((f"{side} wheel", ", ".join(parts)))
    size, square_mm = "square size unknown", square_size_mm(case.extraction)
    if square_mm is not None:
        measured = f"square size {square_mm:.2f} mm, measured by the stereo pair"
        size = measured if board.square_m is None else f"stated square size {square_mm:g} mm"
    return [*rows, ("board", f"{board.columns} x {board.rows} inner corners, {size}")]


@table("setting_sources", "", "", "")
def setting_sources(case: Case) -> Rows:
    """Where each setting comes from."""
    return list(case.extraction.rig.setting_sources.items())


@table("recordings", "", "recording", "code:SHA-256")
def recordings(case: Case) -> Rows:
    """The recordings."""
    return [(log.path, log.sha256) for log in case.provenance.logs]


@table("settings", "", "name:", "code:")
def settings(case: Case) -> Rows:
    """All settings."""
    return list(_flat({k: v for k, v in case.provenance.config.items() if k != "setting_sources"}))


def _flat(value: Setting, key: str = "") -> Iterator[tuple[str, str]]:
    """Nested settings as (dotted key, value as YAML writes it)."""
    if isinstance(value, Mapping) and value:
        for name, item in value.items():
            yield from _flat(item, f"{key}.{name}" if key else name)
    elif isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        for number, item in enumerate(value):
            yield from _flat(item, f"{key}[{number}]")
    else:
        yield key, _yaml(value)


def _yaml(value: object) -> str:
    """A value in YAML's flow style; strings and paths without quotes."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return f"{value:.10g}"
    if isinstance(value, list | tuple | set | frozenset):
        return f"[{', '.join(_yaml(item) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{name}: {_yaml(item)}' for name, item in value.items())}}}"
    return str(value)
