"""What limits an expected error, and what to do about it: the words for each source of errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mobilecal_cli.likelihood import nuisance

#: Stated values dominate from this share of a variance on.
_DOMINANT = 0.5
_FEW_PERCENT = 0.05


@dataclass(frozen=True, slots=True)
class Source:
    """A source of errors.

    Attributes:
        label: as in a list.
        family: its group, a key of `FAMILIES`.
        advice: what reduces it, as a command without a full stop.
    """

    label: str
    family: str
    advice: str


_STATED_CAMERA = "calibrate the cameras again with more images"
_STATED_PAIR = "calibrate the stereo pair again with more images"
_STATED_HEAD = "measure the geometry of the head"
# fmt: off
SOURCES: dict[str, Source] = {
    "pixel_px": Source("corner noise", "corners", "record more stops, with the board closer or more images each"),
    "joint_rad": Source("joint reading noise", "joint readings", "record more stops, and check the head for play"),
    "floor_rad": Source("the uneven floor", "floor", "record on a flat floor, or record more stops"),
    "floor_m": Source("the uneven floor (height)", "floor", "record on a flat floor, or record more stops"),
    "sway_rad": Source("sway of the base", "floor", "stop for images, and let the base come to rest"),
    "sway_m": Source("sway of the base (height)", "floor", "stop for images, and let the base come to rest"),
    "wheel_rad_per_sqrt_rad": Source("wheel noise", "wheels", "record more stops with shorter legs, on a firm floor"),
    "wheel_share": Source("wheel noise in proportion to the distance", "wheels", "record more legs, on a firm floor"),
    "encoder_rad": Source("encoder steps", "encoder steps", "record more legs, or use finer encoders"),
    "stamp_s": Source("jitter of the image time stamps", "time stamps", "stop for images, or use hardware time stamps"),
    "pose_scale": Source("the measured poses", "poses", "measure more poses, or measure them more exactly"),
    "clock": Source("the stated clock offset", "time stamps", "synchronize the clocks"),
    "focal_length": Source("the stated focal length", "camera_info", _STATED_CAMERA),
    "focal_aspect": Source("the stated ratio of the focal lengths", "camera_info", _STATED_CAMERA),
    "stereo_clock": Source("the delay between the cameras", "time stamps", "stop for images, or trigger them together"),
    "readout": Source("the read-out time of the images", "time stamps", "stop for images, or use a global shutter"),
    "principal_point": Source("the stated principal point", "camera_info", _STATED_CAMERA),
    "distortion": Source("the stated lens distortion", "camera_info", _STATED_CAMERA),
    "stereo_rotation": Source("the stated rotation between the cameras", "camera_info", _STATED_PAIR),
    "baseline_direction": Source("the stated direction of the stereo baseline", "camera_info", _STATED_PAIR),
    "baseline_length": Source("the stated length of the stereo baseline", "camera_info", _STATED_PAIR),
    "square_size": Source("the stated size of the squares", "board", "measure the board (ten squares, with a caliper)"),
    "square_aspect": Source("the stated aspect of the squares", "board", "measure the board in both directions"),
    "board_bend": Source("the flatness of the board", "board", "mount the board on a flat plate"),
    "board_shear": Source("the right angle of the board", "board", "measure the diagonals of the board"),
    "board_corners": Source("the places of the board's corners", "board", "use a board that is printed more exactly"),
    "lean": Source("the lean of the base", "floor", "check that the base stands upright"),
    "joint_zero": Source("the stated zero of a head joint", "head geometry", "measure the zeros of the head joints"),
    "joint_scale": Source("the stated scale of a head joint", "head geometry", "check the scale of the joint readings"),
    "joint_axis": Source("the stated axes of the head joints", "head geometry", _STATED_HEAD),
    "joint_position": Source("the stated positions of the head joints", "head geometry", _STATED_HEAD),
    "backlash": Source("backlash of the head joints", "head geometry", "approach each head pose from both sides"),
    "nominal": Source("the uncertainty of the nominal values", "nominal values", "record more varied motion"),
    "unobservable": Source("the missing motion", "nominal values", "record the missing motion"),
    "user priors": Source("the stated priors", "nominal values", "state more accurate priors"),
    "other": Source("other errors", "other", "record more stops"),
}
# fmt: on
#: Group of sources, in the chart's order → its name with a verb.
FAMILIES = {
    "corners": "Corner noise limits",
    "joint readings": "Joint reading noise limits",
    "floor": "The uneven floor limits",
    "wheels": "Wheel noise limits",
    "encoder steps": "Encoder steps limit",
    "poses": "The measured poses limit",
    "time stamps": "Errors of the image time stamps limit",
    "camera_info": "The stated camera calibration (camera_info) limits",
    "board": "The stated geometry of the board limits",
    "head geometry": "The stated geometry of the head limits",
    "nominal values": "The uncertainty of the nominal values limits",
    "other": "Other errors limit",
}


def source(name: str) -> Source:
    """The words for a source of a `Budget`."""
    return SOURCES.get(name, SOURCES["other"])


def limiting_sentence(shares: Sequence[tuple[float, str]], meaning: str) -> str:
    """Which group of sources contributes most to an expected error; "" where nothing is known.

    Args:
        shares: (share, source) of its variance.
        meaning: its label.
    """
    sums = dict.fromkeys(FAMILIES, 0.0)
    for share, name in shares:
        sums[source(name).family] += share
    family = max(sums, key=lambda name: sums[name])
    if not sums[family]:
        return ""
    return f"{FAMILIES[family]} the {meaning}: {100 * sums[family]:.0f} % of its variance."


def advice(shares: Sequence[tuple[float, str]]) -> str:
    """What to do about an expected error with these shares, (share, source), largest first; in whole sentences."""
    if not shares:
        return "Record again with more stops, head motion and turns."
    kinds = {kind.name for kind in nuisance.KINDS}
    stated = [(share, name) for share, name in shares if name in kinds]
    total = sum(share for share, _ in stated)
    if total <= _DOMINANT:
        return _sentence(source(shares[0][1]).advice)
    few = [f"{source(name).label} {100 * share:.0f} %" for share, name in stated[:3] if share > _FEW_PERCENT]
    first = stated[0][1]
    return (
        f"More stations will not help much: {100 * total:.0f} % comes from stated values ({', '.join(few)}). "
        f"{_sentence(source(first).advice)} Then state a smaller `priors: {first}` in rig.yaml."
    )


def _sentence(command: str) -> str:
    return f"{command[0].upper()}{command[1:]}."
