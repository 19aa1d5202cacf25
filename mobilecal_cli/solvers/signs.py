"""Checks of wheel signs: negative values mean a wrong encoder sign or swapped wheels."""

from __future__ import annotations

from mobilecal_cli.errors import SolveError
from mobilecal_cli.model import WheelGeometry


def check_signs(wheels: WheelGeometry) -> None:
    """Refuse negative wheel values and report the cause.

    An encoder with the wrong sign makes its wheel's radius negative. Swapped wheels make the separation negative.

    Raises:
        SolveError: names the wheel with the wrong sign, or reports swapped wheels.
    """
    right, left = wheels.radius_right_m, wheels.radius_left_m
    swapped = wheels.separation_m < 0
    if right > 0 and left > 0 and not swapped:
        return
    turned = [side for side, radius in (("right", right), ("left", left)) if radius < 0]
    if swapped:
        # "right" is then the left wheel: the message uses the names in rig.yaml.
        causes = ["the left and right wheels are swapped"]
        cures = ["exchange wheels.left and wheels.right in rig.yaml"]
    else:
        causes, cures = [], []
    for side in turned:
        causes.append(f"the {side} wheel's encoder has the wrong sign")
        cures.append(f"negate wheels.{side}.sign in rig.yaml")
    raise SolveError(
        f"{' and '.join(causes)}: the estimated wheel radii are {right * 1e3:.1f} mm (right) and "
        f"{left * 1e3:.1f} mm (left), the wheel separation is {wheels.separation_m * 1e3:.1f} mm",
        " and ".join(cures),
    )
