"""Constraints, priors and constants to ignore that the user requests: --fix, --prior and --estimate."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from mobilecal_cli import ranges
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.constants import CONSTANTS, KIND_GROUPS, KINDS, kind_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.rig import Nominal

_GROUPS = {"head_eye": NINE[:6], "rotation": NINE[:3], "translation": NINE[3:6], "wheels": NINE[6:]}
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_OFTEN = ("pan_zero", "pan_scale", "tilt_scale", "backlash_pan", "backlash_tilt")
_KINDS = tuple(kind.name for kind in KINDS)
#: Option → names that it takes beside those of constants, and groups of names.
_OPTIONS: Mapping[str, tuple[tuple[str, ...], Mapping[str, tuple[str, ...]]]] = {
    "--fix": (NINE, _GROUPS),
    "--prior": (NINE, {}),
    "--estimate": (_KINDS, KIND_GROUPS),
}
#: A constant is at most so many of its default prior sigmas from its stated value: more is another quantity or unit.
_MOST_SIGMAS = 20.0
_MOST = {"readout": 0.1}  # s: unknown for most cameras, and stated as 0 then
_PRIOR = re.compile(rf"({_NUMBER})(?:\u00b1|\+-|\+/-)({_NUMBER})")


@dataclass(frozen=True, slots=True)
class Constraints:
    """Fixed parameters, priors and constants to ignore that the user requests.

    Attributes:
        fixed: name → value, None for the nominal value. Rotations are relative to the nominal rotation, rad.
        priors: name → (value, sigma).
        constants: names or kinds of the constants whose stated values are ignored, see `likelihood.constants`.
    """

    fixed: Mapping[str, float | None] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    constants: tuple[str, ...] = ()

    @property
    def given(self) -> dict[str, tuple[str, ...]]:
        """Each constraint as its option and name, or group, for messages → the names that it stands for."""
        valued = [name for name, value in self.fixed.items() if value is not None]  # groups take no values
        return {f"--fix {name}": (name,) for name in valued} | {
            f"{flag} {name}": _OPTIONS[flag][1].get(name, (name,))
            for flag, names in self._by_flag()
            for name in _in_groups(flag, [each for each in names if each not in valued])
        }

    def _by_flag(self) -> tuple[tuple[str, Iterable[str]], ...]:
        return (("--fix", self.fixed), ("--prior", self.priors), ("--estimate", self.constants))

    def without(self, names: Collection[str]) -> Constraints:
        """The same, with some parameters neither fixed nor with a prior."""
        fixed = {name: value for name, value in self.fixed.items() if name not in names}
        priors = {name: prior for name, prior in self.priors.items() if name not in names}
        return replace(self, fixed=fixed, priors=priors)

    def of_planar_sensor(self) -> Constraints:
        """The same, with all that a planar sensor does not show of itself as stated: roll, pitch and height."""
        hidden = {name: None for name in ("r_x", "r_y", "t_z") if name not in self.priors}
        return replace(self, fixed=hidden | dict(self.fixed))

    def check(self, constants: Sequence[str], nominal: Nominal) -> None:
        """Check the names against the constants that a robot has, and relative values against its nominal values.

        Raises:
            ConfigError: an unknown name, or a value that is relative to a nominal value that is not known.
        """
        for flag, names in self._by_flag():
            known = [*_OPTIONS[flag][0], *constants]
            for name in names:
                if name not in known:
                    raise _unknown(flag, name, known)
        fixed = [name for name, value in self.fixed.items() if value is None or name in NINE[:3]]
        relative = {"--fix": fixed, "--prior": [name for name in self.priors if name in NINE[:3]]}
        for key, known_value, own in (
            ("nominal.head_eye", nominal.T_h_reference, NINE[:6]),
            ("nominal.wheels", nominal.wheels, NINE[6:]),
        ):
            if known_value is not None:
                continue
            lacking = {flag: [name for name in names if name in own] for flag, names in relative.items()}
            if any(lacking.values()):
                rotations = {*lacking["--fix"], *lacking["--prior"]} & {*NINE[:3]}
                given = [
                    f"{flag} {name}" for flag, names in lacking.items() for name in _in_groups(flag, names)
                ]
                raise ConfigError(
                    f"{', '.join(given)}: relative to {key}, which is not known",
                    f"set {key} in rig.yaml{'' if rotations else ', or give values: --fix NAME=VALUE'}",
                )

    def check_shown(self, shown: Collection[str]) -> None:
        """Check that a recording shows the constants: otherwise, their values would be ignored.

        Args:
            shown: names and kinds of the parameters and constants that have an effect on the measurements.

        Raises:
            ConfigError: a constant, or a kind or group of them, has none, and is not fixed at its stated value.
        """
        as_stated = {name for name, value in self.fixed.items() if not value}
        unused = [
            f"{flag} {name}"
            for flag, names in self._by_flag()
            for name in _in_groups(flag, names)
            if not {*_OPTIONS[flag][1].get(name, (name,))} & {*shown, *as_stated}
        ]
        if unused:
            raise ConfigError(
                f"{', '.join(unused)}: no effect on the measurements of this recording",
                "leave it out; stereo constants need two cameras, those of the head and backlash joints that turn, and "
                "clock offsets images in motion",
            )


def _in_groups(flag: str, names: Iterable[str]) -> list[str]:
    """Names, with a group in place of all its members."""
    left = list(names)
    for group, members in _OPTIONS[flag][1].items():
        if {*members} <= {*left}:
            left = [*(name for name in left if name not in members), group]
    return left


def _unknown(flag: str, name: str, known: Sequence[str]) -> ConfigError:
    message = f"{flag} {name}: no such parameter or constant"
    if name in _KINDS and flag != "--estimate":
        rows = [row.name for row in CONSTANTS if row.kind == name]
        example = f", or one constant, such as {rows[0]}" if rows else ""
        return ConfigError(
            f"{flag} {name}: a kind of constants, not one parameter",
            f"set all of them with --set priors.{name}={'fixed' if flag == '--fix' else 'NUMBER'}{example}",
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
    if name in _OFTEN:
        return ConfigError(message, "this robot has no such joint: leave it out")
    if near:
        return ConfigError(message, f"did you mean {near[0]}?")
    names = f"kinds: {', '.join((*KIND_GROUPS, *_KINDS))}"
    if flag != "--estimate":
        names = f"parameters: {', '.join(NINE)}"
    return ConfigError(message, f"{names}; docs/reference/rig-yaml.md lists all constants")


def constraints_of(fix: Sequence[str], prior: Sequence[str], estimate: Sequence[str]) -> Constraints:
    """Parse the values of --fix, --prior and --estimate.

    Args:
        fix: NAME or NAME=VALUE; the name of one of the nine parameters, of a group of them, or of a constant. Commas
            separate several, also in the others.
        prior: NAME=VALUE±SIGMA (or +-).
        estimate: constants, kinds of constants or groups of kinds whose stated values are ignored.

    Raises:
        ConfigError: unknown name or wrong format.
    """
    fixed: list[tuple[str, float | None]] = []
    for text in _each(fix):
        name, given, number = text.partition("=")
        if given and not re.fullmatch(_NUMBER, number.strip()):
            raise ConfigError(
                f"--fix {text}: {number!r} is not a number",
                "give lengths in m, angles in rad and ratios as shares",
            )
        fixed.append((name, float(number) if given else None))
    priors: list[tuple[str, tuple[float, float]]] = []
    for text in _each(prior):
        name, _, rest = text.partition("=")
        match = _PRIOR.fullmatch(rest.replace(" ", ""))
        if match is None:
            raise ConfigError(
                f"--prior {text}: not in the format NAME=VALUE±SIGMA",
                f"for example --prior {name}=0.1±0.002; lengths in m, angles in rad, ratios as shares",
            )
        priors.append((name, (float(match[1]), float(match[2]))))
    names: list[str] = []
    for text in estimate:
        named = [name for name in _each([text]) if name]
        if not named:
            raise ConfigError(
                f"--estimate {text!r}: names no constant", "for example --estimate pan_zero,stereo"
            )
        names += named
    return checked_constraints(fixed, priors, names)


def _each(texts: Iterable[str]) -> list[str]:
    """The entries of the values of an option, which commas separate."""
    return [entry.strip() for text in texts for entry in text.split(",")]


def checked_constraints(
    fix: Iterable[tuple[str, float | None]],
    prior: Iterable[tuple[str, tuple[float, float]]],
    estimate: Iterable[str],
) -> Constraints:
    """Constraints from names with their values, see `constraints_of`; groups are replaced by their members.

    Raises:
        ConfigError: an unknown name, a name given twice, or a value that is no number or out of range.
    """
    fixed: dict[str, float | None] = {}
    for name, value in fix:
        members = _members("--fix", name)
        if value is not None and name in _GROUPS:
            raise ConfigError(
                f"--fix {name}={value}: {name} is a group of parameters and takes no value",
                f"omit the value, or fix one of {', '.join(_GROUPS[name])}",
            )
        exact = None if value is None else _in_range("--fix", name, value)
        for member in members:
            _check_new("--fix", member, fixed)
            fixed[member] = exact
    priors: dict[str, tuple[float, float]] = {}
    for name, (mean, sigma) in prior:
        _members("--prior", name)
        _check_new("--prior", name, fixed, priors)
        mean = _in_range("--prior", name, mean)
        priors[name] = mean, ranges.SIGMA.check(f"--prior {name}: standard deviation", sigma)
    constants: list[str] = []
    for name in estimate:
        for member in _members("--estimate", name):
            _check_new("--estimate", member, fixed, priors)
            constants.append(member)
    return Constraints(fixed, priors, tuple(dict.fromkeys(constants)))


def _members(flag: str, name: str) -> tuple[str, ...]:
    """The parameters, constants or kinds that a name stands for."""
    own, groups = _OPTIONS[flag]
    if name not in (*own, *groups) and _kind_named(name) is None:
        raise _unknown(flag, name, [*own, *groups, *(row.name for row in CONSTANTS)])
    return groups.get(name, (name,))


def _kind_named(name: str) -> str | None:
    """The kind of a constant, by its name; one that depends on the robot is checked when the robot is known."""
    named = [row.kind for row in CONSTANTS if row.name == name]
    matching = [kind.name for kind in KINDS if kind.names and re.fullmatch(kind.names, name)]
    # The last that matches: `focal_aspect_left` is no focal length.
    return next(iter(named + matching[::-1]), None)


def _in_range(flag: str, name: str, value: float) -> float:
    """The value of one of the nine parameters, or the difference of a constant from its stated value.

    Raises:
        ConfigError: it is out of range.
    """
    if name in NINE:
        return ranges.of_parameter(name).check(f"{flag} {name}", value)
    kind = kind_of(_kind_named(name) or "")
    share = kind.unit == "1"
    unit = ("of the image width" if kind.shown_unit != "%" else "of the stated value") if share else kind.unit
    most = _MOST.get(kind.name, _MOST_SIGMAS * kind.sigma)
    example = f"as a share (0.01 is 1 {kind.shown_unit})" if share else f"in {kind.unit}"
    return ranges.Range(-most, most, unit).check(
        f"{flag} {name}",
        value,
        f"give the difference of the {kind.meaning} from its stated value, {example}, not the value itself; "
        "correct a stated value that is further off",
    )


def _check_new(flag: str, name: str, fixed: Collection[str], priors: Collection[str] = ()) -> None:
    for other, names in (("--fix", fixed), ("--prior", priors)):
        if name in names:
            raise ConfigError(
                f"{flag} {name}: given twice" + (f", also with {other}" if other != flag else ""),
                "name each parameter or constant once",
            )
