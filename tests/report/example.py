"""A simulated robot, its recording without images, and the solution: what the tests report on."""

from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

import cv2
import numpy as np

from mobilecal_cli.calibrate.detect import thumbnail_jpeg
from mobilecal_cli.calibrate.steps import Data, Fit, Report
from mobilecal_cli.export.params import params_yaml, with_verdict
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot, Knowledge
from mobilecal_cli.model.observations import Extraction, LogSource, Snapshot
from mobilecal_cli.model.rig import FACTORS, Board, JointLink, Nominal
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.model.solution import Method, Provenance, Solution
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.fleet import FleetRow
from mobilecal_cli.report.page import report_html
from mobilecal_cli.report.values import ReportData, build_report
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import constraints_of, solve
from tests.actual import draw
from tests.extractions import STATION_NOISE, Noise, joined, simulated
from tests.pairs import with_pair
from tests.robots import true_nominal

ROBOT = TICK_ROBOT
WHEELS = ROBOT.wheels
NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=5e-4)


@cache
def make_extraction(n: int = 12, logs: int = 1, seed: int = 0) -> Extraction:
    """Stations of one or several recordings, with a few rejections and a note."""
    parts = [simulated("standard", NOISE, ROBOT, n, seed + log) for log in range(logs)]
    start_ns = parts[0].observations[0].time_ns
    return replace(
        with_nominal(joined(*parts), Nominal()),
        rejections=(
            Rejection("stations", "the base moved", "0.021 rad in 0.4 s", start_ns + 31 * 10**9),
            Rejection("vision", "board partly hidden", "41 of 54 corners", start_ns + 40 * 10**9, 12),
            Rejection("vision", "board partly hidden", "48 of 54 corners", start_ns + 46 * 10**9, 13),
        ),
        notes=("/joint_states: 3 messages share a stamp with the one before; the first was kept.",),
        logs=tuple(LogSource(f"robot_{log}.mcap", f"{log:x}" * 64) for log in range(logs)),
        counts={"stations": n * logs + 3, "pictures": 10 * n * logs},
    )


def with_nominal(extraction: Extraction, nominal: Nominal) -> Extraction:
    return replace(extraction, rig=replace(extraction.rig, nominal=nominal))


@cache
def make_solution(extraction: Extraction, method: Method = "lm") -> Solution:
    return solve(extraction, method)


def report_on(solution: Solution, extraction: Extraction) -> Report:
    """The report on a solution by the default method."""
    return Report(Data(extraction), Fit(solution, extraction, "ml"))


def make_provenance(extraction: Extraction) -> Provenance:
    return Provenance(
        version="0.1.0",
        created="2015-06-01T12:00:00Z",
        method="lm",
        logs=extraction.logs,
        config={"board": {"columns": 9, "rows": 6}, "cameras": {"left": {"image": "/stereo/left/image_raw"}}},
    )


def params_of(solution: Solution, extraction: Extraction, level="", reasons=(), **provenance) -> str:
    """params.yaml of a solution, with a verdict if there is one; further arguments replace the provenance's."""
    text = params_yaml(solution, extraction, replace(make_provenance(extraction), **provenance))
    return with_verdict(text, level, reasons) if level else text


def case_of(
    solution: Solution, extraction: Extraction, trial=None, change=None, gates=None, **provenance
) -> Case:
    """A solution with its verdict; further arguments replace what the provenance says."""
    origin = replace(make_provenance(extraction), **provenance)
    return Case(solution, extraction, origin, gates or {}, trial, change)


def made(*args, **more) -> ReportData:
    """The report on a solution; arguments as for `case_of`."""
    return build_report(case_of(*args, **more))


def rows_of(report: ReportData, section: str, title: str = "") -> dict[str, tuple[str, ...]]:
    """Rows of a table by their first cell; empty without the table."""
    (*found,) = (table for table in report.tables if (table.section, table.title) == (section, title))
    return {row[0]: row[1:] for table in found for row in table.rows}


def page_of(solution: Solution, extraction: Extraction, snapshots=(), **more) -> str:
    """The page on a solution; further arguments as for `case_of`."""
    case = case_of(solution, extraction, **more)
    return report_html(build_report(case), case, snapshots)


def _picture(board: Board, corners: FloatArray, rng: np.random.Generator) -> bytes:
    """The board drawn from its corners (one square added all round by extrapolation), as JPEG."""
    H, _ = cv2.findHomography(board.grid()[:, :2].astype(np.float32), corners.astype(np.float32))
    image = np.full((480, 640), 95, dtype=np.uint8)
    cv2.rectangle(image, (0, 330), (640, 480), 70, -1)
    for row in range(-2, board.rows + 1):
        for column in range(-2, board.columns + 1):
            inside = -1 <= row < board.rows and -1 <= column < board.columns
            square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
            square += [column, row]
            p = cv2.perspectiveTransform(square[None], H)[0]
            tone = 45 if inside and (row + column) % 2 == 0 else 205
            cv2.fillConvexPoly(image, np.round(p * 16).astype(np.int32), tone, cv2.LINE_AA, 4)
    image = np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8)
    return bytes(cv2.imencode(".jpg", image)[1])


def make_snapshots(extraction: Extraction) -> tuple[Snapshot, ...]:
    rng = np.random.default_rng(5)
    return tuple(
        Snapshot(
            o.log,
            o.station,
            {
                name: _picture(extraction.board, view.pixels, rng)
                for name, view in zip(extraction.rig.cameras.names, o.views, strict=True)
            },
            thumbnail_jpeg(rng.integers(0, 255, (480, 640), np.uint8)),
        )
        for o in extraction.observations
    )


HOSTILE = "</title><script>alert(1)</script>\"'&\x00\x1b[31m\u202e$x_{$ {{7*7}} \udcff"


def make_hostile(extraction: Extraction) -> Extraction:
    """The same, with every string that a log can set turned nasty."""
    rig = extraction.rig
    camera = replace(rig.cameras.each[0], frame_id=HOSTILE)
    rig = replace(
        rig,
        cameras=with_pair(rig.cameras, left=camera),
        chain=replace(
            rig.chain,
            base_frame=HOSTILE,
            head_frame=HOSTILE,
            links=tuple(
                replace(link, joint=HOSTILE + link.joint) if isinstance(link, JointLink) else link
                for link in rig.chain.links
            ),
            pan=HOSTILE + rig.chain.pan,
            tilt=HOSTILE + rig.chain.tilt,
        ),
        sources=replace(
            rig.sources,
            image={"left": HOSTILE, "right": HOSTILE},
            info={"left": HOSTILE, "right": ""},
            joints={HOSTILE: HOSTILE},
        ),
        setting_sources={HOSTILE: HOSTILE},
    )
    return replace(
        extraction,
        rig=rig,
        rejections=(Rejection(HOSTILE, HOSTILE, HOSTILE, -5, 3),),
        notes=(HOSTILE,),
        logs=(LogSource(HOSTILE, "0" * 64),),
        counts={HOSTILE: 3, "stations": 15},
    )


def hostile_solution(solution, hostile):
    """The solution with the names of a hostile recording."""
    return replace(solution, cameras=hostile.rig.cameras, motion={HOSTILE: 1.0})


def robot(wheels=WHEELS, std=None):
    covariance = np.zeros((9, 9)) if std is None else np.eye(9) * std**2
    knowledge = None if std is None else Knowledge(covariance, np.ones(9, dtype=bool))
    return CalibratedRobot("head", "camera", np.eye(4), wheels, knowledge)


STATION_LEVELS = replace(STATION_NOISE, pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=5e-4)


def recorded(constants, noise=STATION_LEVELS, motion="standard", stations=12, seed=1):
    extraction = simulated(motion, noise, ROBOT, stations, seed, constants=constants)
    return replace(with_nominal(extraction, true_nominal(ROBOT)), logs=(LogSource("log.mcap", "0" * 64),))


@cache
def solved(*constants, motion="standard", fixed=()):
    extraction = recorded(dict(constants), motion=motion)
    return solve(extraction, constraints=constraints_of(list(fixed), [], [])), extraction


@cache
def drawn():
    extraction = recorded(draw(TICK_ROBOT, np.random.default_rng(1)))
    return solve(extraction), extraction


def with_uncertainty(solution, **changes):
    return replace(solution, uncertainty=replace(solution.uncertainty, **changes))


def with_noise(solution, **levels):
    return with_uncertainty(solution, noise=replace(solution.uncertainty.noise, **levels))


def with_share(solution, source, share):
    """The solution with a budget in which one source has a share of everything."""
    budget = solution.uncertainty.budget
    at = budget.sources.index(source)
    rest = (1 - share) / (len(budget.sources) - 1)
    column = np.full(len(budget.sources), rest)
    column[at] = share
    budget = replace(
        budget, nine=np.repeat(column[:, None], 9, axis=1), at_work=dict.fromkeys(budget.at_work, column)
    )
    return with_uncertainty(solution, budget=budget)


VOID = {"meta", "br", "link", "img"}


class Page(HTMLParser):
    """Checks that every element closes in order, and gathers what the tests ask for."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        assert len(attrs) == len(dict(attrs)), f"<{tag}> has an attribute twice"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script", "title"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def fleet_row(
    name,
    verdict="PASS",
    code=0,
    reason="",
    turn=(0.0,) * 3,
    lengths=(0.1,) * 6,
    multipliers=(),
    std=1e-3,
    **more,
):
    """A row of a fleet: rotation vector, rad; position and wheels, m; or multipliers of odometry alone for these."""
    values = dict(zip((*NINE[: 3 + len(lengths)], *FACTORS), (*turn, *lengths, *multipliers), strict=False))
    return FleetRow(name, verdict, code, reason, 12, values, dict.fromkeys(values, std), **more)
