"""The sentences of the criteria on a calibration that is evaluated on a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mobilecal_cli.report.check import Check
from mobilecal_cli.report.wording.words import Words, part

_QUANTITIES = {
    "camera_rotation": "camera rotation",
    "camera_position": "camera position",
    "radius_right": "right wheel radius",
    "radius_left": "left wheel radius",
    "separation": "wheel separation",
}


def _stations(c: Check) -> Words:
    return Words(
        "stations",
        f"{c.value:g}",
        f"at least {c.limit:g}",
        f"Both cameras see the board at {c.value:g} stations; at least {c.limit:g} are needed.",
        "Record at least ten stations.",
    )


def _corner_error(c: Check) -> Words:
    limit_px, best_px = c.facts["limit_px"], c.facts["best_px"]
    if c.outcome == "not_enough":
        why = f"No parameters explain this recording: the best leave {best_px:.1f} px (limit {limit_px:.1f} px)."
        cure = "Check for wheel slip, a moved board and wrong encoder settings, and record again."
    else:
        best = "" if best_px is None else f"; the recording's own estimate leaves {best_px:.1f} px"
        why = (
            f"The median station-to-station corner error is {c.value:.1f} px (limit {limit_px:.1f} px){best}."
        )
        cure = "Check that params.yaml belongs to this robot and is in meters; otherwise calibrate again."
    return Words(
        "median station-to-station corner error", f"{c.value:.2f} px", f"at most {c.limit:.1f} px", why, cure
    )


def _own_estimate(c: Check) -> Words:
    message, hint = c.facts["message"], c.facts["hint"]
    return Words(
        "estimate from this recording",
        "none",
        "all nine parameters",
        f"This recording cannot be solved by itself: {message}.",
        f"{hint[:1].upper()}{hint[1:]}." if hint else "Record again.",
    )


def _agreement(c: Check) -> Words:
    name, f = _QUANTITIES[part(c)], c.facts
    limit = f"at most {c.limit:g} {c.unit}, or {f['sigmas']:g} sigma"
    if c.value is None:
        cure = f["cure"] or "record more motion of base and head"
        why = f"The {name} is unobservable in this recording."
        return Words(name, "unobservable", limit, why, f"{cure[:1].upper()}{cure[1:]}.")
    if c.outcome == "fail":
        why = (
            f"The {name} differs from this recording by {c.value:.2g} ± {f['sigma']:.1g} {c.unit} "
            f"(limit {c.limit:g} {c.unit})."
        )
        cure = "Calibrate again, and check what has changed on the robot: camera mount, tires, load."
    else:
        why = (
            f"This recording gives the {name} to {f['largest']:.2g} {c.unit} (1 sigma); {f['needed']:.2g} {c.unit} "
            "are needed."
        )
        cure = "Record more stations; mobilecal suggest lists the most useful ones."
    return Words(name, f"{c.value:.2g} ± {f['sigma']:.1g} {c.unit}", limit, why, cure)


def dependence(used: Sequence[str], logs: int) -> tuple[str, ...]:
    """A note if the calibration was made from some of the evaluated recordings."""
    if not used:
        return ()
    which = "This recording was" if logs == 1 else f"{', '.join(used)} {'was' if len(used) == 1 else 'were'}"
    return (f"{which} used for this calibration: the errors below are not independent.",)


def agreement(checks: Sequence[Check], independent: bool) -> tuple[str, str]:
    """Reason and next step where a calibration passes."""
    each = (_agreement(check) for check in checks if check.id.startswith("agreement."))
    next_step = "Use params.yaml on the robot."
    if not independent:
        next_step = "Evaluate a recording that was not used for this calibration."
    said = ", ".join(f"{one.name} {one.measured}" for one in each)
    return f"The calibration agrees with this recording: {said}.", next_step


WORDS: dict[str, Callable[[Check], Words]] = {
    "evaluated_stations": _stations,
    "corner_error": _corner_error,
    "own_estimate": _own_estimate,
    "agreement": _agreement,
}
