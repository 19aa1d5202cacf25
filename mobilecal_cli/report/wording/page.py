"""The sentences of the page that depend on the result."""

from __future__ import annotations

from mobilecal_cli.report.parameters import std_text, value_text
from mobilecal_cli.report.values import ChangeData, ReportData, ResultData

_REFINEMENTS = {
    "paper": "Powell's method",
    "lm": "Levenberg-Marquardt",
    "ml": "maximum likelihood with Levenberg-Marquardt. The point error can rise because noisy points have less weight",
}
_INITIAL = {
    "grid": "the best of a grid of wheel ratios",
    "nominal": "the nominal wheels",
    "given": "the given wheel ratios",
}
_RANKS = {
    "worst": "Worst leg",
    "median": "Median leg",
    "best": "Best leg",
    "only": "The leg with images",
    "": "Leg",
}


def page_words(report: ReportData) -> dict[str, str]:
    """Name in the template → sentences."""
    method, change = report.quality.method, report.change
    solutions = "The solution was not refined."
    if report.refinement is not None:
        solutions = (
            "The refined solution starts from it and weights each measurement by its own noise (maximum likelihood). "
            "Its point error can be larger although its parameters are more accurate."
            if method == "ml"
            else "The refined solution starts from it and minimizes the point error. The two solutions should be close."
        )
    return {
        "solutions": solutions,
        "orientation": _orientation(report.parameters),
        "change": "" if change is None else _change(change),
        "refinement": _REFINEMENTS.get(method, method),
        "initial": f"Initial estimate: {_INITIAL[report.linear.initial_from]}.",
    }


def leg_title(rank: str, first: str, second: str, error_px: float, error_mm: float) -> str:
    """Title of the images of a leg between two stations."""
    return f"{_RANKS[rank]}, from station {first} to {second}: {error_px:.2f} px, {error_mm:.1f} mm"


def _orientation(found: ResultData) -> str:
    """Quaternion, and Euler angles with their standard deviations; without these near gimbal lock."""
    quaternion = ", ".join(f"{q:.6f}" for q in found.quaternion_xyzw)
    shown, angles, stds = (
        f"Quaternion (x, y, z, w): {quaternion}.",
        found.euler_zyx_deg,
        found.euler_zyx_std_deg,
    )
    if angles is None:
        margin = f"{found.gimbal_margin_deg:.1f}"
        return f"{shown} Euler angles are not shown: the orientation is {margin}° from gimbal lock."
    each = (
        f"{axis} = {value_text(angle, None if stds is None else stds[k], 3)}°"
        + ("" if stds is None else f" ± {std_text(stds[k])}°")
        for k, (axis, angle) in enumerate(zip("xyz", angles, strict=True))
    )
    return f"{shown} Euler angles, R = Rz(z) Ry(y) Rx(x): {', '.join(each)}."


def _change(change: ChangeData) -> str:
    in_sigma = any(s is not None for s in change.sigmas)
    more = "; in sigma: divided by the standard deviation of the difference" if in_sigma else ""
    text = f"Change: difference from {change.against}{more}."
    if change.p_value is not None:
        text += (
            " If the robot did not change, the probability of a difference this large is "
            f"{100 * change.p_value:.2g} %."
        )
    return text
