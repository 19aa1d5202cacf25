"""The terms of the report, and links to their definitions. docs/reference/glossary.md defines the same terms."""

from __future__ import annotations

import re
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True, slots=True)
class Term:
    """One entry of the glossary.

    Attributes:
        key: its anchor, after "term-".
        name: its heading.
        pattern: regular expression for the words that link to it.
        definition: one or two sentences.
    """

    key: str
    name: str
    pattern: str
    definition: str


TERMS = (
    Term("contradiction", "Contradiction", "contradict(?:ions?|s)?",
         "A stated value of the robot description that the recording disagrees with by more than four standard "
         "deviations. The solver then trusts it less."),
    Term("dead-reckoning", "Dead reckoning", "dead reckoning",
         "The path of the base, computed from the wheel rotations alone."),
    Term("error-budget", "Error budget", "error budget",
         "What share of a variance comes from each source: corners, joints, floor, wheels, and each kind of stated "
         "value."),
    Term("gimbal-lock", "Gimbal lock", "gimbal lock",
         "An orientation at which Euler angles are not unique: the middle angle is near ±90°. Use the rotation "
         "vector or the quaternion there."),
    Term("head-eye", "Head-eye transform", "head-eye transform",
         "The pose of the reference camera in the frame of the last head link: rotation and translation."),
    Term("hold-out", "Hold-out", "hold-out|held-out|held out",
         "Data kept aside: it has no influence on the result, and the result is tested on it."),
    Term("initial", "Initial estimate", "initial estimates?",
         "The parameters from which an iterative method starts."),
    Term("jackknife", "Jackknife", "jackknife",
         "A second estimate of the standard deviations. It leaves out parts of the data in turn and measures how "
         "much the result changes."),
    Term("leg", "Leg", "legs?", "The motion of the base from one station to the next."),
    Term("linear", "Linear solution", "linear (?:solution|method)",
         "The result of the iterative linear method of Kim and Jeong (2015). It is the start of the refinement."),
    Term("ml", "Maximum likelihood", "maximum likelihood",
         "The method that weights each measurement by its own noise and finds the parameters that explain all "
         "measurements best."),
    Term("nine", "Nine parameters", "nine parameters|nine-parameter model",
         "The head-eye transform (six parameters), the right and left wheel radius, and the wheel separation."),
    Term("nominal", "Nominal value", "nominal (?:values?|wheels|head-eye transform)",
         "The value of a parameter before calibration, from the URDF or from rig.yaml."),
    Term("observable", "Observable", "(?:un)?observable",
         "A parameter is observable if the motion in the recording determines it. An unobservable parameter "
         "keeps its nominal value, with the standard deviation of a nominal value."),
    Term("outlier", "Outlier", "outliers?",
         "A station, leg or reading that is inconsistent with the others. The solver leaves it out."),
    Term("point-error", "Point error", "point errors?",
         "The station-to-station corner error in space, root mean square in mm. The paper's Table 1 calls it Error."),
    Term("prior", "Prior", "priors?",
         "What is known of a parameter or a constant of the robot description without the recording: a value with its "
         "standard deviation. The solver treats it as one more measurement."),
    Term("rejected", "Rejected", "rejected|rejections?",
         "A station or image is rejected before the solve if it gives no usable measurement."),
    Term("reprojection", "Reprojection error", "reprojection errors?",
         "The station-to-station corner error in the images, root mean square in px."),
    Term("residual", "Residual", "residuals?",
         "The difference between a measurement and its prediction by the solution."),
    Term("rotation-vector", "Rotation vector", "rotation vectors?",
         "A rotation written as its axis times its angle. It is unique for all angles below 180°."),
    Term("sigma", "Sigma", "standard deviations?|sigmas?",
         "Standard deviation (1 sigma): the expected size of the error. The true value is within 1 sigma in 68 % of "
         "cases and within 2 sigma in 95 %."),
    Term("station", "Station", "stations?",
         "A moment at which both cameras see the board, usually while the robot stands still."),
    Term("corner-error", "Station-to-station corner error", "station-to-station corner errors?",
         "How well the nine parameters predict the board corners of one station from those of the next."),
)  # fmt: skip

_ANY = re.compile(
    r"(?<![\w-])(?:"
    + "|".join(f"(?P<t{i}>{term.pattern})" for i, term in enumerate(TERMS)).replace(" ", r"\s+")
    + r")(?![\w-])",
    re.IGNORECASE,
)
_TAG = re.compile(r"(<[^>]*>)")
_NAME = re.compile(r"</?([a-zA-Z0-9]+)")
#: Elements whose text gets no links: code, drawings, headings, the glossary itself, and links.
_PLAIN = frozenset(
    {"style", "title", "svg", "code", "a", "h1", "h2", "h3", "th", "summary", "dl", "label", "button"}
)


def link_terms(page: str) -> str:
    """The page with a link from the first use of each term in each section to its definition.

    Args:
        page: HTML in which "<" and ">" occur in tags only.
    """
    parts = _TAG.split(page)
    linked: set[str] = set()
    plain = 0  # depth of elements that get no links
    for i, part in enumerate(parts):
        if not part.startswith("<"):
            if not plain and part.strip():
                parts[i] = _ANY.sub(lambda match: _link(match, linked), part)
            continue
        found = _NAME.match(part)
        name = found.group(1).lower() if found else ""
        if name == "section":
            linked.clear()
        elif name in _PLAIN and not part.endswith("/>"):
            plain += -1 if part.startswith("</") else 1
    return "".join(parts)


def _link(match: re.Match[str], linked: set[str]) -> str:
    term = TERMS[int((match.lastgroup or "t0")[1:])]
    if term.key in linked:
        return match.group()
    linked.add(term.key)
    return f'<a class="term" href="#term-{term.key}" title="{escape(term.definition)}">{match.group()}</a>'
