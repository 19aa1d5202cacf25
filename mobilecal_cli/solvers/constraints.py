"""Constraints, priors and constants to ignore that the user requests: --fix, --prior and --estimate."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mobilecal_cli import ranges
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import NINE

_GROUPS = {
    "head_eye": NINE[:6],
    "rotation": NINE[:3],
    "translation": NINE[3:6],
    "wheels": NINE[6:],
}
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# Constants that depend on the robot's joints: their names are checked when the robot is known.
_OF_THE_ROBOT = re.compile(r".+_(?:zero|scale|axis_[xyz]|position_[xyz])|backlash_.+|baseline_[xyz]")
_OFTEN = ("pan_zero", "pan_scale", "tilt_scale", "backlash_pan", "backlash_tilt")
_KINDS = tuple(kind.name for kind in nuisance.KINDS)
#: Group → its kinds of constants, for --estimate.
_KIND_GROUPS = {
    "stereo": ("stereo_rotation", "baseline_direction", "baseline_length"),
    "lenses": ("focal_length", "focal_aspect", "principal_point", "distortion"),
    "board": ("square_size", "square_aspect", "board_bend", "board_shear", "board_corners"),
    "head": ("joint_zero", "joint_scale", "joint_axis", "joint_position", "backlash"),
}
_PRIOR = re.compile(rf"({_NUMBER})(?:\u00b1|\+-|\+/-)({_NUMBER})")


@dataclass(frozen=True, slots=True)
class Constraints:
    """Fixed parameters, priors and constants to ignore that the user requests.

    Attributes:
        fixed: name → value, None for the nominal value. Rotations are relative to the nominal rotation, rad.
        priors: name → (value, sigma).
        constants: names or kinds of the constants whose stated values are ignored, see `nuisance`.
    """

    fixed: Mapping[str, float | None] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    constants: tuple[str, ...] = ()

    def check(self, constants: Sequence[str]) -> None:
        """Check the names against the constants that a robot has.

        Raises:
            ConfigError: an unknown name.
        """
        for flag, names in (("--fix", self.fixed), ("--prior", self.priors), ("--estimate", self.constants)):
            known = [*(_KINDS if flag == "--estimate" else NINE), *constants]
            for name in names:
                if name not in known:
                    raise _unknown(flag, name, known)


def _unknown(flag: str, name: str, known: Sequence[str]) -> ConfigError:
    message = f"{flag} {name}: no such parameter or constant"
    if name in _KINDS and flag != "--estimate":
        rows = [row.name for row in nuisance.CONSTANTS if row.kind == name]
        one = f", or one constant, such as {rows[0]}" if rows else ""
        return ConfigError(
            f"{flag} {name}: a kind of constants, not one parameter",
            f"set all of them with --set priors.{name}={'fixed' if flag == '--fix' else 'NUMBER'}{one}",
        )
    if name in NINE and flag == "--estimate":
        return ConfigError(
            f"--estimate {name}: already estimated, like all nine parameters", "name a constant or a kind"
        )
    if name.startswith("tilt_zero") or name == "tilt":
        return ConfigError(
            message,
            "the zero offset of the last joint is a head-eye rotation and cannot be estimated separately",
        )
    near = difflib.get_close_matches(name, [*known, *_OFTEN], 1)
    if near:
        return ConfigError(message, f"did you mean {near[0]}?")
    kinds = (
        f"kinds: {', '.join((*_KIND_GROUPS, *_KINDS))}; "
        if flag == "--estimate"
        else f"parameters: {', '.join(NINE)}; "
    )
    return ConfigError(message, f"{kinds}docs/reference/rig-yaml.md lists all constants")


def _value(flag: str, text: str, number: str) -> float:
    if not re.fullmatch(_NUMBER, number.strip()):
        raise ConfigError(
            f"{flag} {text}: {number!r} is not a number",
            "give lengths in m, angles in rad and ratios as shares",
        )
    return ranges.of_parameter(text.partition("=")[0]).check(f"{flag} {text}", float(number))


def constraints_of(fix: Sequence[str], prior: Sequence[str], estimate: Sequence[str]) -> Constraints:
    """Parse the values of --fix, --prior and --estimate.

    Args:
        fix: NAME or NAME=VALUE; the name of one of the nine parameters, of a group of them, or of a constant.
        prior: NAME=VALUE±SIGMA (or +-).
        estimate: constants, kinds of constants or groups of kinds whose stated values are ignored, separated by commas.

    Raises:
        ConfigError: unknown name or wrong format.
    """
    named = (name.strip() for text in estimate for name in text.split(",") if name.strip())
    requested = tuple(member for name in named for member in _KIND_GROUPS.get(name, (name,)))
    fixed_rows = [row.name for row in nuisance.CONSTANTS]
    for name in requested:
        if name not in (*_KINDS, *fixed_rows) and not _OF_THE_ROBOT.fullmatch(name):
            raise _unknown("--estimate", name, [*_KIND_GROUPS, *_KINDS, *fixed_rows])
    known = [*NINE, *_GROUPS, *fixed_rows]
    fixed: dict[str, float | None] = {}
    for text in fix:
        name, given, number = text.partition("=")
        if name not in known and not _OF_THE_ROBOT.fullmatch(name):
            raise _unknown("--fix", name, known)
        if given and name in _GROUPS:
            raise ConfigError(
                f"--fix {text}: {name} is a group of parameters and takes no value",
                f"omit the value, or fix one of {', '.join(_GROUPS[name])}",
            )
        for member in _GROUPS.get(name, (name,)):
            fixed[member] = _value("--fix", text, number) if given else None
    priors: dict[str, tuple[float, float]] = {}
    for text in prior:
        name, _, rest = text.partition("=")
        if name not in (*NINE, *fixed_rows) and not _OF_THE_ROBOT.fullmatch(name):
            raise _unknown("--prior", name, [*NINE, *fixed_rows])
        match = _PRIOR.fullmatch(rest.replace(" ", ""))
        if match is None:
            raise ConfigError(
                f"--prior {text}: not in the format NAME=VALUE±SIGMA",
                f"for example --prior {name}=0.1±0.002; lengths in m, angles in rad, ratios as shares",
            )
        sigma = ranges.SIGMA.check(f"--prior {text}: standard deviation", float(match[2]))
        priors[name] = (_value("--prior", text, match[1]), sigma)
    return Constraints(fixed, priors, requested)
