"""Real stereo pairs with a camera_info that is made wrong on purpose: the board before and after the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from mobilecal_cli import camera as lens
from mobilecal_cli import se3
from mobilecal_cli.likelihood.constants import camera_change, table
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.observations import Corners, Extraction, Observation, WheelTrack
from mobilecal_cli.model.rig import Board, Camera, CameraRig, Side
from mobilecal_cli.model.signals import Rejection, Station
from mobilecal_cli.model.solution import EXACT
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import Constraints
from mobilecal_cli.solvers.findings import contradictions_of
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.maximum_likelihood import robust_fit
from mobilecal_cli.vision import Detection, Miss, detect, resolve_square
from mobilecal_cli.vision.observing import StationCorners
from mobilecal_cli.vision.pose import absolute_orientation, board_pose, square_from_points, triangulate
from tests.bench import study
from tests.bench.study import Study
from tests.pairs import measure, pair_of, with_pair
from tests.robots import chain_of, rig_of
from tests.vision.scenes import bouguet as bouguet_rig

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
_SQUARE_M = 0.03  # stated with Bouguet's pictures; assumed for MRPT's
_BOARD = Board(9, 6, _SQUARE_M)
_POINTS_K = _SQUARE_M * _BOARD.grid()
_CHAIN = ("joint_zero", "joint_scale", "joint_axis", "joint_position", "backlash", "clock")
_LEVELS = ("joint_rad", "floor_rad", "floor_m", "stamp_s", "wheel_share", "wheel_rad_per_sqrt_rad")
_SECOND_NS = 10**9
_BIG = 4  # times as wrong, to see what is named
Pair = tuple[Detection, Detection]


def pairs_in(folder: Path) -> tuple[tuple[Pair, ...], tuple[int, int]]:
    """Corners of all pairs in a folder that show the board in both pictures, and the pictures' (width, height)."""
    found, size = [], (0, 0)
    for first in sorted(folder.rglob("*left*.jpg")):
        second = first.with_name(first.name.replace("left", "right"))
        pictures = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (first, second)]
        seen = [detect(picture, _BOARD.columns, _BOARD.rows) for picture in pictures if picture is not None]
        left, right = (d for d in seen if isinstance(d, Detection))
        found.append((left, right))
        size = pictures[0].shape[1], pictures[0].shape[0]
    return tuple(found), size


def by_opencv(pairs: Sequence[Pair], size: tuple[int, int], jointly: bool = False) -> CameraRig:
    """OpenCV's calibration: each camera by itself, then the pair; jointly: all together after that."""
    points = [_POINTS_K.astype(np.float32)] * len(pairs)
    seen = [[pair[k].pixels.astype(np.float32)[:, None] for pair in pairs] for k in range(2)]
    own = [cv2.calibrateCamera(points, corners, size, None, None, flags=cv2.CALIB_FIX_K3) for corners in seen]
    cameras = [part for _, K, D, *_ in own for part in (K, D)]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 if jointly else cv2.CALIB_FIX_INTRINSIC
    _, K_l, D_l, K_r, D_r, R, t, *_ = cv2.stereoCalibrate(points, *seen, *cameras, size, flags=flags)
    left = Camera("left", *size, np.asarray(K_l, float), np.ravel(D_l), "plumb_bob")
    right = Camera("right", *size, np.asarray(K_r, float), np.ravel(D_r), "plumb_bob")
    return pair_of(left, right, se3.inverse(se3.transform(R, t[:, 0])))


def wrong_intrinsics(true: CameraRig, folder: Path) -> CameraRig:
    """The pair with the wrong intrinsics that lie beside the pictures of OpenCV."""
    file = cv2.FileStorage(str(folder / "intrinsics_wrong.yml"), cv2.FILE_STORAGE_READ)
    numbers = [(file.getNode(f"M{k}").mat(), np.ravel(file.getNode(f"D{k}").mat())) for k in (1, 2)]
    each = zip(true.each, numbers, strict=True)
    return with_pair(true, *(replace(camera, K=K, D=D) for camera, (K, D) in each))


# -- what is made wrong -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """What is wrong with a camera_info.

    Attributes:
        constants: what is added to the true values, as the estimator's constants count.
        k1: what is added to k1 of each side.
        right: kinds that are a right answer to "what is wrong?".
    """

    constants: Mapping[str, float] = field(default_factory=dict)
    k1: Mapping[Side, float] = field(default_factory=dict)
    right: tuple[str, ...] = ()

    def times(self, factor: float) -> Case:
        """The same, so many times as wrong."""
        constants = {name: factor * value for name, value in self.constants.items()}
        return Case(constants, {side: factor * value for side, value in self.k1.items()}, self.right)

    def of(self, true: CameraRig) -> CameraRig:
        """The wrong stereo pair."""
        rig = camera_change(true, table(true, chain_of(TICK_ROBOT)), self.constants).apply(true)
        sides: dict[Side, Camera] = {"left": rig.each[0], "right": rig.each[1]}
        for side, k1 in self.k1.items():
            sides[side] = replace(sides[side], D=sides[side].D + k1 * np.eye(len(sides[side].D))[0])
        return with_pair(rig, left=sides["left"], right=sides["right"])

    def expected(self, true: CameraRig) -> dict[str, float]:
        """What the estimate should find, to first order in the errors: constants that make the pair right again."""
        found = {name: -value for name, value in self.constants.items()}
        for side in self.k1:
            which = ["left", "right"].index(side)
            terms = _radial(true.each[which], Case(k1=self.k1).of(true).each[which])
            found |= {f"distortion_{side}_radial_{k}": value for k, value in enumerate(terms, 1)}
        return found


def _radial(true: Camera, stated: Camera) -> FloatArray:
    """(2,) radial terms that come nearest to the true distortion, over the rays that the picture shows."""
    u, v = np.meshgrid(np.linspace(0, true.width, 33), np.linspace(0, true.height, 25))
    flat, good = lens.undistorted(true, np.stack([u, v], axis=-1).reshape(-1, 2))
    rays = np.column_stack([flat[good], np.ones(good.sum())])
    at = lens.project(stated, rays)
    terms, _ = lens.lens_terms(stated, stated.K[:2, 2], at, np.zeros(4))
    off = lens.project(true, rays) - at
    A = terms[..., :2].reshape(-1, 2)
    return np.asarray(np.linalg.lstsq(A, off.ravel(), rcond=None)[0])


_TURN = float(np.radians(0.2))


def cases(width: int) -> dict[str, Case]:
    """One thing at a time, then all of them; pictures of so many px."""
    px, both = 5 / width, ("left", "right")
    points = {f"principal_{side}_{axis}": px for side in both for axis in "xy"}
    focal, point, turned = ("focal_length",), ("principal_point",), ("stereo_rotation",)
    found = {
        "nothing": Case(),
        "focal length of both, +0.5 %": Case({f"focal_{side}": 0.005 for side in both}, right=focal),
        "focal length of the left, +0.5 %": Case({"focal_left": 0.005}, right=focal),
        "principal point of the left, x, +5 px": Case({"principal_left_x": px}, right=point),
        "principal point of the left, y, +5 px": Case({"principal_left_y": px}, right=point),
        "principal points of both, x and y, +5 px": Case(points, right=point),
        "k1 of the left, +0.02": Case(k1={"left": 0.02}, right=("distortion",)),
        "k1 of both, +0.02": Case(k1={"left": 0.02, "right": 0.02}, right=("distortion",)),
    }
    for axis in "xyz":
        case = Case({f"stereo_r_{axis}": _TURN}, right=turned)
        found[f"right camera, turned by 0.2 deg about {axis}"] = case
    length = ("baseline_length", "square_size")
    found["baseline, +0.5 %"] = Case({"baseline_scale": 0.005}, right=length)
    mixed = {f"focal_{side}": 0.005 for side in both} | {"principal_left_x": px, "baseline_scale": 0.005}
    mixed |= {f"stereo_r_{axis}": _TURN for axis in "xyz"}
    right = (*focal, *point, *turned, *length, "distortion")
    everything = "focal lengths, principal point x, k1 of the left, turn about x, y, z, baseline"
    return found | {everything: Case(mixed, {"left": 0.02}, right)}


# -- the estimate -------------------------------------------------------------------------------------


def _corners(rig: CameraRig, pair: Pair) -> tuple[Corners, Corners]:
    """Corners of both pictures, with their noise as the stated cameras show it."""
    left, right = (StationCorners.of([d], _BOARD) for d in pair)
    return left.average(_BOARD, rig.each[0]), right.average(_BOARD, rig.each[1])


def _observation(rig: CameraRig, number: int, pair: Pair) -> Observation:
    """The board of one pair, whatever its residuals; a station that the product refuses is observed as well."""
    views = _corners(rig, pair)
    points = triangulate(rig, views)
    assert not isinstance(points, Miss), points.detail
    square_m = square_from_points(points.points_c, _BOARD.grid())
    start = absolute_orientation(points.points_c, square_m * _BOARD.grid())
    pose = board_pose(rig, _POINTS_K, views, start)
    still = np.zeros(len(TICK_ROBOT.joint_names))
    return Observation(
        log=number,
        station=0,
        time_ns=_SECOND_NS,
        at_rest=True,
        joints=still,
        joints_std=still,
        views=views,
        points_c=points.points_c,
        points_cov=points.points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        square_m=square_m,
        reprojection_px=pose.rms_px,
    )


def refusal(rig: CameraRig, pair: Pair) -> str | None:
    """Why the product refuses a station with this pair; None if it does not."""
    still = np.zeros(len(TICK_ROBOT.joint_names))
    station = Station(0, True, (), _SECOND_NS, still, still)
    found = measure(station, *([d] for d in pair), rig, _BOARD)
    settled = found if isinstance(found, Rejection) else resolve_square(found, _SQUARE_M)
    return settled.detail if isinstance(settled, Rejection) else None


def extraction_of(rig: CameraRig, pairs: Sequence[Pair]) -> Extraction:
    """A recording of one station for each pair, of a robot whose head and base are exact and do not move."""
    seen = tuple(_observation(rig, number, pair) for number, pair in enumerate(pairs))
    robot = replace(
        rig_of(TICK_ROBOT),
        cameras=rig,
        prior_sigmas=dict.fromkeys(_CHAIN, 0.0),
        noise=dict.fromkeys(_LEVELS, EXACT),
    )
    rest = WheelTrack.at_same_times(np.array([0, 2 * _SECOND_NS]), np.zeros(2), np.zeros(2))
    return Extraction(robot, _BOARD, seen, (rest,) * len(seen), (), (), (), {})


def estimated(rig: CameraRig, pairs: Sequence[Pair]) -> LikelihoodFit:
    """The product's estimate of the cameras and the board from a stated rig; the nine parameters are fixed."""
    extraction = extraction_of(rig, pairs)
    nominal = extraction.rig.nominal
    assert nominal.T_h_reference is not None
    assert nominal.wheels is not None
    inference = Inference.of(extraction, Constraints(dict.fromkeys(NINE)))
    return robust_fit(inference, Parameters(nominal.T_h_reference, nominal.wheels))


def improved(fit: LikelihoodFit) -> CameraRig:
    """The stereo pair as estimated."""
    return fit.lin.state.cameras


# -- figures ------------------------------------------------------------------------------------------

FIGURES = (
    "mean error of the squares (mm)", "their standard deviation (mm)", "every other corner: rotation (deg)",
    "translation (mm)", "half boards: rotation (deg)", "translation (mm)", "reprojection (px)",
)  # fmt: skip


def _sides_mm(points: FloatArray) -> FloatArray:
    """Sides of all squares, from (M, 3) corners in m."""
    grid = points.reshape(_BOARD.rows, _BOARD.columns, 3)
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    return np.asarray(1e3 * np.concatenate(sides))


def _apart(rig: CameraRig, pair: Pair, start: FloatArray, first: FloatArray) -> FloatArray:
    """(6,) board pose from the corners of the first half against that from the others, at the board's center."""
    center = np.eye(4)
    center[:3, 3] = _POINTS_K.mean(axis=0)
    poses, seen = [], _corners(rig, pair)
    for half in (first, ~first):
        views = [replace(corners, seen=half) for corners in seen]
        poses.append(board_pose(rig, _POINTS_K, views, start).T_c_k @ center)
    turn = se3.log_so3(poses[0][:3, :3].T @ poses[1][:3, :3])
    return np.concatenate([turn, poses[1][:3, 3] - poses[0][:3, 3]])


def figures(rigs: Sequence[CameraRig], pairs: Sequence[Pair]) -> FloatArray:
    """(7,) values of `FIGURES`, each pair seen by its own rig."""
    row, column = np.divmod(np.arange(_BOARD.corners), _BOARD.columns)
    splits = (row + column) % 2 == 0, column < _BOARD.columns / 2
    sides, apart, squares = [], [], []
    for rig, pair in zip(rigs, pairs, strict=True):
        seen = _observation(rig, 0, pair)
        sides.append(_sides_mm(seen.points_c))
        apart.append([_apart(rig, pair, seen.T_c_k, split) for split in splits])
        squares.append(seen.reprojection_px**2)
    error = np.concatenate(sides) - 1e3 * _SQUARE_M
    turns_moves = np.sqrt(np.sum(np.mean(np.array(apart) ** 2, axis=0).reshape(2, 2, 3), axis=2))
    scaled = turns_moves * [np.degrees(1), 1e3]
    return np.array([error.mean(), error.std(), *scaled.ravel(), np.sqrt(np.mean(squares))])


@dataclass(frozen=True, eq=False)
class Result:
    """One case.

    Attributes:
        before, after: figures with the stated rig, and with the one estimated from the same pairs.
        others: each pair seen with the rig that was estimated from all other pairs; NaN where that was not tried.
        refused: why the product refuses stations.
        found: name → (value, standard deviation) of each constant.
        named: contradicted (kind, part), most significant first.
        left_out: number of corners that were left out.
    """

    before: FloatArray
    after: FloatArray
    others: FloatArray
    refused: tuple[str, ...]
    found: Mapping[str, tuple[float, float]]
    named: tuple[tuple[str, str], ...]
    left_out: int


def compared(rig: CameraRig, pairs: Sequence[Pair], others: bool = True) -> Result:
    """What an estimate from a stated rig makes of it; `others`: each pair is also seen with a rig estimated without it."""
    count = len(pairs)
    refused = tuple(why for pair in pairs if (why := refusal(rig, pair)) is not None)
    fit = estimated(rig, pairs)
    layout, without = fit.data.layout, np.full(len(FIGURES), np.nan)
    if others:
        rest = [[*pairs[:k], *pairs[k + 1 :]] for k in range(count)]
        without = figures([improved(estimated(rig, some)) for some in rest], pairs)
    std = dict(zip(layout.names, np.sqrt(np.diag(fit.covariance))[: layout.size].tolist(), strict=True))
    return Result(
        figures([rig] * count, pairs),
        figures([improved(fit)] * count, pairs),
        without,
        refused,
        {row.name: (fit.lin.state.value(row.name), std[row.name]) for row in layout.constants},
        tuple((e.kind, e.part) for e in contradictions_of(fit)),
        int(np.sum(~fit.inliers.used_corners)),
    )


# -- tables -------------------------------------------------------------------------------------------

_DIGITS = (3, 3, 3, 3, 2, 2, 3)


def _board_row(name: str, result: Result) -> list[str]:
    values = zip(result.before, result.after, result.others, _DIGITS, strict=True)
    return [name, *(f"{a:.{n}f} → {b:.{n}f} ({c:.{n}f})" for a, b, c, n in values)]


def _named(result: Result, right: Sequence[str]) -> list[str]:
    said = [f"{part}: {what}{'' if what in right else ' (wrong)'}" for what, part in result.named]
    return [str(len(result.refused)), str(result.left_out), ", ".join(said) or "none"]


def _found_rows(name: str, case: Case, true: CameraRig, both: tuple[Result, Result]) -> Iterator[list[str]]:
    """Rows of the constants that were made wrong; both: with nothing wrong, and of the case."""
    nothing, result = both
    rows = {row.name: row for row in table(true, chain_of(TICK_ROBOT))}
    for constant, expected in case.expected(true).items():
        of_kind = rows[constant].of_kind
        value, std = (of_kind.shown * v for v in result.found[constant])
        zero = of_kind.shown * nothing.found[constant][0]
        numbers = (of_kind.shown * expected, zero, value, std)
        yield [name, f"`{constant}` ({of_kind.shown_unit})", *(f"{v:.3f}" for v in numbers)]
        name = ""


#: A rig, pairs, and kinds that are a right answer to "what is wrong?".
Task = tuple[CameraRig, Sequence[Pair], Sequence[str]]


def _study(true: CameraRig, pairs: Sequence[Pair], more: Mapping[str, Task]) -> str:
    """All tables of one set of pairs; more: name → what is wrong in another way."""
    of_case = cases(true.each[0].width)
    tasks: dict[str, Task] = {name: (case.of(true), pairs, case.right) for name, case in of_case.items()}
    tasks |= more
    big = [case.times(_BIG).of(true) for case in of_case.values()]
    with ProcessPoolExecutor() as pool:
        rigs, of_task = zip(*((rig, some) for rig, some, _ in tasks.values()), strict=True)
        results = dict(zip(tasks, pool.map(compared, rigs, of_task), strict=True))
        alone = pool.map(partial(compared, others=False), big, [pairs] * len(big))
        at_big = dict(zip(of_case, alone, strict=True))
    board, found, named = [], [], []
    for name, result in results.items():
        board.append(_board_row(name, result))
        right = tasks[name][2]
        other = _named(at_big[name], right) if name in at_big else [""] * 3
        named.append([name, *_named(result, right), *other])
        if name in of_case:
            found += list(_found_rows(name, of_case[name], true, (results["nothing"], result)))
    causes = ("refused stations", "corners left out", "contradictions named")
    heads = ["wrong", "constant", "to be found", "found with nothing wrong", "found", "sigma"]
    tables = study.table(["wrong", *FIGURES], board), study.table(heads, found)
    big_causes = (f"{cause}, {_BIG} times as wrong" for cause in causes)
    return "\n".join([*tables, study.table(["wrong", *causes, *big_causes], named)])


def bouguet() -> str:
    """Tables of the seven pairs with Bouguet's published calibration as the truth."""
    folder = DATA / "stereo" / "opencv_samples"
    pairs, size = pairs_in(folder)
    odd, even = pairs[::2], pairs[1::2]
    intrinsics = ("distortion", "focal_length", "principal_point")
    direction = ("baseline_direction",)  # 1.1 and 1.2 degrees from the published one
    more: dict[str, Task] = {
        "`intrinsics_wrong.yml`": (wrong_intrinsics(bouguet_rig(), folder), pairs, intrinsics)
    }
    halves = ("1, 3, 5, 7", odd, "2, 4, 6", even), ("2, 4, 6", even, "1, 3, 5, 7", odd)
    for these, some, those, others in halves:
        name = f"calibrated by OpenCV from pairs {these}; used on {those}"
        more[name] = (by_opencv(some, size), others, direction)
    more |= {f"nothing; used on {those}": (bouguet_rig(), others, ()) for _, _, those, others in halves}
    return _study(bouguet_rig(), pairs, more)


def mrpt() -> str:
    """Tables of the four pairs with OpenCV's joint calibration from all of them as the truth."""
    pairs, size = pairs_in(DATA / "stereo" / "mrpt_stereo_calib")
    steps = by_opencv(pairs, size), pairs, ("stereo_rotation", "principal_point")
    return _study(by_opencv(pairs, size, jointly=True), pairs, {"calibrated by OpenCV in two steps": steps})


def main(_: Study) -> None:
    """All tables."""
    if not DATA.is_dir():
        print("The pictures for this study are not available.")
        return
    print("### Bouguet's seven pairs\n\n" + bouguet())
    print("### MRPT's four pairs\n\n" + mrpt())
