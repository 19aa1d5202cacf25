"""Cameras and boards with known ground truth, and a renderer independent of the code under test."""

from functools import cache
from itertools import product
from typing import Any

import cv2
import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board, Camera, CameraRig
from mobilecal_cli.vision import Detection, Miss
from tests.pairs import pair_of


def detected(result: Detection | Miss) -> Detection:
    """The corners of a board that must be found."""
    assert isinstance(result, Detection), result
    return result


def missed(result: object) -> Miss:
    """The reason where no board, or no points, may be found."""
    assert isinstance(result, Miss), result
    return result


def bouguet() -> CameraRig:
    """Bouguet's stereo calibration over all of his pairs, published with them; OpenCV's samples are seven of them."""
    K = [[533.5, 0, 341.6], [0, 533.5, 235.2], [0, 0, 1]], [[536.8, 0, 326.3], [0, 536.5, 250.1], [0, 0, 1]]
    D = [-0.288, 0.097, 0.001, -0.0003, 0], [-0.289, 0.107, 0.001, -0.0001, 0]
    sides = zip(("left", "right"), K, D, strict=True)
    left, right = (Camera(side, 640, 480, np.array(k), np.array(d), "plumb_bob") for side, k, d in sides)
    turn = se3.exp_so3(np.array([0.00669, 0.00452, -0.00350]))
    T_r_c = se3.transform(turn, np.array([-0.099802, 0.001124, 0.000050]))
    return pair_of(left, right, se3.inverse(T_r_c))


K = np.array([[550.0, 0.0, 322.0], [0.0, 548.0, 241.0], [0.0, 0.0, 1.0]])
K_RIGHT = np.array([[552.0, 0.0, 317.0], [0.0, 551.0, 245.0], [0.0, 0.0, 1.0]])
PLUMB_BOB = [-0.28, 0.09, 0.0007, -0.0004, 0.0]
EQUIDISTANT = [-0.02, 0.004, -0.003, 0.0007]


def stereo_rig(kind: str = "raw") -> CameraRig:
    """A pair with a baseline of 0.12 m: raw (distorted, turned a little), fisheye, or rectified."""
    distortion, D = {
        "raw": ("plumb_bob", PLUMB_BOB),
        "fisheye": ("equidistant", EQUIDISTANT),
        "rectified": ("none", []),
    }[kind]
    turn = np.zeros(3) if kind == "rectified" else np.array([0.007, -0.012, 0.004])
    T_c_r = se3.transform(se3.exp_so3(turn), np.array([0.12, 0.001 * any(turn), -0.002 * any(turn)]))
    left = Camera("left_optical", 640, 480, K, np.array(D), distortion)
    right = Camera("right_optical", 640, 480, K_RIGHT, np.array(D), distortion)
    return pair_of(left, right, T_c_r, kind == "rectified")


def pose(
    x: float, y: float, z: float, tilt: tuple[float, float, float], board: Board, square_m: float
) -> np.ndarray:
    """T_c_k with the board's middle at (x, y, z) m, turned from facing the camera by a rotation vector, rad."""
    R = se3.exp_so3(np.array(tilt))
    middle = square_m * np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0.0])
    return se3.transform(R, np.array([x, y, z]) - R @ middle)


def random_pose(rng: np.random.Generator, board: Board, square_m: float) -> np.ndarray:
    z = rng.uniform(0.9, 1.6)
    tilt = tuple(rng.uniform(-0.5, 0.5, 3))
    x, y = 0.06 + 0.1 * z * rng.uniform(-1, 1), 0.1 * z * rng.uniform(-1, 1)
    return pose(x, y, z, tilt, board, square_m)


def opencv_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(M, 3) points in the camera's frame → (M, 2) px, by OpenCV."""
    zero, points = np.zeros(3), np.ascontiguousarray(points)[:, None]
    D = camera.D if len(camera.D) else np.zeros(5)
    project = cv2.fisheye.projectPoints if camera.distortion == "equidistant" else cv2.projectPoints
    return project(points, zero, zero, camera.K, D)[0].reshape(-1, 2)


def seen(
    rig: CameraRig, T_c_k: np.ndarray, board: Board, square_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners in c (M, 3), and their true pixels in both images."""
    points_c = se3.act(T_c_k, square_m * board.grid())
    points_r = se3.act(np.linalg.inv(rig.T_c_each[1]), points_c)
    return points_c, opencv_pixels(rig.each[0], points_c), opencv_pixels(rig.each[1], points_r)


@cache
def _rays(camera: Camera) -> np.ndarray:
    """z = 1 coordinates of all pixels' centers and of those around them, by fixed-point iteration: (..., 2)."""
    u, v = np.meshgrid(np.arange(-1.0, camera.width + 1), np.arange(-1.0, camera.height + 1))
    target = np.stack([(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1]], axis=-1)
    if camera.distortion == "none":
        return target
    if camera.distortion == "equidistant":
        angle = np.hypot(*np.moveaxis(target, -1, 0))
        assert not np.any(camera.D), "only the pure projection is inverted here"
        # A ray at 90 degrees and beyond has no z = 1 coordinates; these are far outside any board.
        return target * (np.tan(np.minimum(angle, 1.55)) / np.maximum(angle, 1e-12))[..., None]
    k1, k2, p1, p2, k3 = camera.D
    ray = target.copy()
    for _ in range(25):
        x, y = ray[..., 0], ray[..., 1]
        q = x * x + y * y
        radial = 1 + q * (k1 + q * (k2 + q * k3))
        along_x, along_y = 2 * p1 * x * y + p2 * (q + 2 * x * x), p1 * (q + 2 * y * y) + 2 * p2 * x * y
        shift = np.stack([along_x, along_y], axis=-1)
        ray = (target - shift) / radial[..., None]
    return ray


def render(
    camera: Camera,
    T_camera_k: np.ndarray,
    board: Board,
    square_m: float,
    *,
    noise: float = 0.0,
    blur_px: float = 0.0,
    seed: int = 0,
    **drawn: Any,
) -> np.ndarray:
    """An image of the board, see `painted`: blurred, with noise, in whole gray levels."""
    mixed = painted(camera, T_camera_k, board, square_m, **drawn)
    if blur_px:
        mixed = cv2.GaussianBlur(mixed, (0, 0), blur_px, borderType=cv2.BORDER_REPLICATE)
    if noise:
        mixed = mixed + np.random.default_rng(seed).normal(0, noise, mixed.shape)
    image = np.clip(np.round(mixed), 0, 255).astype(np.uint8)
    image.setflags(write=False)
    return image


def painted(
    camera: Camera,
    T_camera_k: np.ndarray,
    board: Board,
    square_m: float,
    *,
    picture: np.ndarray | None = None,
    dark: float = 40.0,
    light: float = 200.0,
    outer: float = 1.0,
    background: float = 110.0,
    supersample: int = 4,
) -> np.ndarray:
    """The light on every pixel, gray levels: the mean of supersample^2 rays cut with the board's plane.

    The outer square diagonally next to corner 0 is dark. Outer squares are `outer` squares wide, and a light
    margin of one square surrounds them. With `picture` the board is painted over it.
    """
    # Rays through the centers of pixels; those between are interpolated (error below 0.001 px for these lenses).
    rays = _rays(camera)
    H = np.linalg.inv(np.column_stack([T_camera_k[:3, 0], T_camera_k[:3, 1], T_camera_k[:3, 3]]))
    reach = max(board.columns, board.rows) / 2 + outer + 2
    middle = square_m * np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0.0])
    x, y, z = T_camera_k[:3, :3] @ middle + T_camera_k[:3, 3]
    radius = 1.2 * reach * square_m
    close = (np.hypot(rays[..., 0] * z - x, rays[..., 1] * z - y) < 1.6 * radius)[1:-1, 1:-1]
    rows, columns = np.flatnonzero(close.any(axis=1)), np.flatnonzero(close.any(axis=0))
    (v0, v1), (u0, u1) = (rows[0], rows[-1] + 1), (columns[0], columns[-1] + 1)

    lifted = np.ascontiguousarray(np.moveaxis(rays @ H[:, :2].T + H[:, 2], -1, 0))

    def on_board(around: dict[tuple[int, int], np.ndarray], du: float, dv: float) -> tuple[np.ndarray, ...]:
        """Dark or light, and covered or not, at an offset of pixels and those around; and the square's numbers."""
        a, b = int(np.sign(du)), int(np.sign(dv))
        p, q = abs(du), abs(dv)
        weights = ((0, 0, (1 - q) * (1 - p)), (0, a, (1 - q) * p), (b, 0, q * (1 - p)), (b, a, q * p))
        x, y, z = sum(weight * around[j, i] for j, i, weight in weights)
        X, Y = x / z / square_m, y / z / square_m
        squares = (-outer < X) & (board.columns - 1 + outer > X) & (-outer < Y) & (board.rows - 1 + outer > Y)
        margin = (-outer - 1 < X) & (board.columns + outer > X) & (-outer - 1 < Y) & (board.rows + outer > Y)
        is_dark = squares & ((np.floor(X) + np.floor(Y)) % 2 == 0)
        return is_dark, margin & (z > 0), squares, np.floor(X), np.floor(Y)

    paint = np.full((camera.height, camera.width), float(light))
    cover = np.zeros((camera.height, camera.width))
    offset = (np.arange(supersample) + 0.5) / supersample - 0.5
    inside, steps = (slice(v0, v1), slice(u0, u1)), list(product((-1, 0, 1), repeat=2))
    whole = {(j, i): lifted[:, v0 + 1 + j : v1 + 1 + j, u0 + 1 + i : u1 + 1 + i] for j, i in steps}
    corners = [on_board(whole, du, dv) for dv, du in product(offset[[0, -1]], repeat=2)]
    paint[inside] += np.where(corners[0][0], dark - light, 0.0)
    cover[inside] += corners[0][1]
    # Where its corners lie in one square, so does the whole pixel.
    others = ((values, first) for c in corners[1:] for values, first in zip(c, corners[0], strict=True))
    cut = np.any([values != first for values, first in others], axis=0)
    rows, columns = np.nonzero(cut)
    edge = (rows + v0, columns + u0)
    near = {step: values[:, cut] for step, values in whole.items()}
    parts = [on_board(near, du, dv)[:2] for dv, du in product(offset, offset)]
    paint[edge] = light + (dark - light) * np.mean([is_dark for is_dark, _ in parts], axis=0)
    cover[edge] = np.mean([covered for _, covered in parts], axis=0)
    # Light mixes in a pixel in proportion to the area: exact because paint is constant where cover is not 1.
    base = np.full(paint.shape, background) if picture is None else picture.astype(np.float64)
    return cover * np.where(cover > 1 - 1e-9, paint, light) + (1 - cover) * base
