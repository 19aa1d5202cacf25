"""Negative wheels: what they say about the encoders."""

from __future__ import annotations

from mobilecal_cli.errors import SolveError
from mobilecal_cli.model import WheelGeometry


def check_signs(wheels: WheelGeometry) -> None:
    """Refuse wheels that are negative, and say why they are.

    A counter that runs backwards turns its wheel's radius negative. Two wheels taken for each other leave the
    radii as they are and turn the separation negative.

    Raises:
        SolveError: naming the wheel whose sign is turned round, or that the wheels are swapped.
    """
    right, left = wheels.radius_right_m, wheels.radius_left_m
    swapped = wheels.separation_m < 0
    if right > 0 and left > 0 and not swapped:
        return
    turned = [side for side, radius in (("right", right), ("left", left)) if radius < 0]
    if swapped:
        # What is called right is the left wheel: name the sources, as the user knows them.
        causes = ["the left and right wheel are swapped"]
        cures = ["exchange wheels.left and wheels.right in rig.yaml"]
    else:
        causes, cures = [], []
    for side in turned:
        causes.append(f"the {side} wheel's sign is turned round")
        cures.append(f"turn wheels.{side}.sign in rig.yaml")
    raise SolveError(
        f"{' and '.join(causes)}: the log gives radii of {right * 1e3:.1f} mm (right) and {left * 1e3:.1f} mm "
        f"(left) and a separation of {wheels.separation_m * 1e3:.1f} mm",
        ", and ".join(cures),
    )
