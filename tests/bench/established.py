"""The same likelihood given to Ceres (pyceres): the same optimum? At what cost in time and memory?"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.export import extraction_from_npz, extraction_to_npz
from mobilecal_cli.kinematics import head_jacobian, head_pose, integrate, integrate_with_jacobian
from mobilecal_cli.likelihood.legs import leg_covariance
from mobilecal_cli.likelihood.noise import Selection
from mobilecal_cli.likelihood.problem import Problem, State, problem_of
from mobilecal_cli.likelihood.system import terms_at
from mobilecal_cli.model import WheelGeometry
from mobilecal_cli.simulate.ideal import ideal_extraction
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers.descent import Ties, descend, terms_before
from mobilecal_cli.solvers.linear import linear_estimate
from mobilecal_cli.solvers.loops import closed_loops
from mobilecal_cli.solvers.placing import state_at
from tests.bench.simulated import DISTURBED, TRUE_NOISE, conditions, route_of

_SIZES = (12, 200, 2000)
_Z = np.array([0.0, 0.0, 1.0])


def start_of(path: Path) -> tuple[Problem, State]:
    """The problem and the linear start, the same for both solvers."""
    extraction = extraction_from_npz(path)
    problem, loops = problem_of(extraction), closed_loops(extraction)
    parameters = linear_estimate(loops, extraction.rig.nominal.wheels).parameters
    return problem, state_at(problem, parameters, loops, Selection.everything(problem))


def vector(state: State) -> np.ndarray:
    """(9,) rotation vector, translation and wheels."""
    X, wheels = state.parameters.T_h_c, state.parameters.wheels
    sizes = [wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]
    return np.concatenate([se3.log_so3(X[:3, :3]), X[:3, 3], sizes])


def by_mobilecal(problem: Problem, start: State) -> tuple[State, float]:
    """The product's own descent."""
    nine = np.zeros(9)
    ties = Ties(start.parameters, np.zeros((0, 9)), np.zeros(0), np.ones(9), nine, nine)
    began = time.perf_counter()
    optimum = descend(terms_before(problem, start, Selection.everything(problem), TRUE_NOISE), ties)
    return optimum.state, time.perf_counter() - began


def by_ceres(problem: Problem, start: State) -> tuple[State, float]:
    """Ceres, sparse Schur complement, analytic derivatives; coordinates of its own."""
    import pyceres

    X0, board0 = start.parameters.T_h_c, start.T_w_k[0]
    head_eye = np.concatenate([np.zeros(3), X0[:3, 3]])
    board = np.zeros(6)  # board0 (exp(w), p)
    wheels = vector(start)[6:]
    bases = [row.copy() for row in start.base]
    errors = [np.zeros(problem.joints.shape[1]) for _ in bases]
    covariance = leg_covariance(problem, start.parameters.wheels, TRUE_NOISE)
    roots = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2)
    steps, rig = problem.steps(), problem.cameras
    T_r_c = se3.inverse(rig.T_c_r)

    class Views(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, station: int) -> None:
            super().__init__()
            self.station = station
            self.set_num_residuals(4 * len(problem.points_k))
            self.set_parameter_block_sizes([6, 6, 3, problem.joints.shape[1]])

        def Evaluate(self, parameters, residuals, jacobians):  # type: ignore[no-untyped-def]
            X, k, base, error = parameters
            joints = problem.joints[self.station] + error
            R_X = se3.exp_so3(X[:3]) @ X0[:3, :3]
            turned = problem.points_k @ se3.exp_so3(k[:3]).T
            p_w = (turned + k[3:]) @ board0[:3, :3].T + board0[:3, 3]
            Rz = se3.rotation_z(base[2])
            p_v = (p_w - [base[0], base[1], 0.0]) @ Rz
            H = head_pose(problem.chain, joints)
            p_h = (p_v - H[:3, 3]) @ H[:3, :3]
            p_c = (p_h - X[3:]) @ R_X
            at, J_left = project_with_jacobian(rig.left, p_c)
            at_r, J_right = project_with_jacobian(rig.right, se3.act(T_r_c, p_c))
            sigma = TRUE_NOISE.pixel_px * problem.relative_sigma[self.station]
            seen = problem.pixels[self.station]
            residuals[:] = np.stack([(at - seen[0]) / sigma[0], (at_r - seen[1]) / sigma[1]]).ravel()
            if jacobians is None:
                return True
            J_c = np.stack([J_left / sigma[0], J_right @ T_r_c[:3, :3] / sigma[1]])  # (2, M, 2, 3)
            J_h, R_h = J_c @ R_X.T, H[:3, :3]
            J_v = J_h @ R_h.T
            J_w = J_v @ Rz.T
            if jacobians[0] is not None:
                turn = np.cross(J_h, (p_h - X[3:])[:, None, :]) @ se3.left_jacobian_so3(X[:3])
                jacobians[0][:] = np.concatenate([turn, -J_h], axis=-1).ravel()
            if jacobians[1] is not None:
                J_b = J_w @ board0[:3, :3]
                turn = np.cross(turned[:, None, :], J_b) @ se3.left_jacobian_so3(k[:3])
                jacobians[1][:] = np.concatenate([turn, J_b], axis=-1).ravel()
            if jacobians[2] is not None:
                heading = -J_v @ np.cross(_Z, p_v)[:, :, None]
                jacobians[2][:] = np.concatenate([-J_w[..., :2], heading], axis=-1).ravel()
            if jacobians[3] is not None:
                J_q = head_jacobian(problem.chain, joints)
                shift = np.cross(J_q[:3].T[None], p_h[:, None, :]) + J_q[3:].T  # (M, J, 3)
                jacobians[3][:] = (-J_h @ np.swapaxes(shift, 1, 2)).ravel()
            return True

    class Leg(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self, leg: int) -> None:
            super().__init__()
            self.steps, self.root = steps.select(np.array([leg])), roots[leg]
            self.set_num_residuals(3)
            self.set_parameter_block_sizes([3, 3, 3])

        def Evaluate(self, parameters, residuals, jacobians):  # type: ignore[no-untyped-def]
            first, second, sizes = parameters
            geometry = WheelGeometry(*sizes)
            cos, sin = np.cos(first[2]), np.sin(first[2])
            dx, dy = second[:2] - first[:2]
            x, y = cos * dx + sin * dy, -sin * dx + cos * dy
            motion = integrate(self.steps, geometry)
            off = [motion.t_m[0, 0] - x, motion.t_m[0, 1] - y, motion.psi_rad[0] - (second[2] - first[2])]
            residuals[:] = self.root @ off
            if jacobians is None:
                return True
            by_second = np.array([[-cos, -sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, -1.0]])
            by_first = -by_second
            by_first[:2, 2] = [-y, x]
            _, d_psi, d_t = integrate_with_jacobian(self.steps, geometry)
            by_wheels = np.concatenate([d_t[0], d_psi])
            for block, part in zip(jacobians, (by_first, by_second, by_wheels), strict=True):
                if block is not None:
                    block[:] = (self.root @ part).ravel()
            return True

    class Reading(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(problem.joints.shape[1])
            self.set_parameter_block_sizes([problem.joints.shape[1]])

        def Evaluate(self, parameters, residuals, jacobians):  # type: ignore[no-untyped-def]
            residuals[:] = parameters[0] / TRUE_NOISE.joint_rad
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = (np.eye(len(residuals)) / TRUE_NOISE.joint_rad).ravel()
            return True

    began = time.perf_counter()
    ceres, costs = pyceres.Problem(), []
    for station, (base, error) in enumerate(zip(bases, errors, strict=True)):
        costs += [Views(station), Reading()]
        ceres.add_residual_block(costs[-2], None, [head_eye, board, base, error])
        ceres.add_residual_block(costs[-1], None, [error])
    for leg, (i, j) in enumerate(problem.legs):
        costs.append(Leg(leg))
        ceres.add_residual_block(costs[-1], None, [bases[i], bases[j], wheels])
    ceres.set_parameter_block_constant(bases[0])
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    options.num_threads = 1
    options.function_tolerance, options.parameter_tolerance, options.gradient_tolerance = 1e-14, 1e-12, 1e-14
    options.minimizer_progress_to_stdout = False
    summary = pyceres.SolverSummary()
    pyceres.solve(options, ceres, summary)
    seconds = time.perf_counter() - began
    T_h_c = se3.transform(se3.exp_so3(head_eye[:3]) @ X0[:3, :3], head_eye[3:])
    T_w_k = board0 @ se3.transform(se3.exp_so3(board[:3]), board[3:])
    parameters = replace(start.parameters, T_h_c=T_h_c, wheels=WheelGeometry(*(float(w) for w in wheels)))
    end = replace(
        start, parameters=parameters, T_w_k=T_w_k[None], base=np.stack(bases), joint_errors=np.stack(errors)
    )
    return end, seconds


def one(solver: str, path: Path) -> None:
    """In a process of its own: solve, and print what came of it as JSON."""
    problem, start = start_of(path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    end, seconds = {"mobilecal": by_mobilecal, "ceres": by_ceres}[solver](problem, start)
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    everything = Selection.everything(problem)
    covariance = leg_covariance(problem, start.parameters.wheels, TRUE_NOISE)
    cost = terms_at(problem, end, everything, TRUE_NOISE, covariance).cost
    print(json.dumps({"seconds": seconds, "mb": memory, "cost": cost, "nine": vector(end).tolist()}))


def main() -> None:
    """All sizes, or those given as arguments."""
    if len(sys.argv) == 4 and sys.argv[1] == "one":
        one(sys.argv[2], Path(sys.argv[3]))
        return
    sizes = [int(text) for text in sys.argv[1:]] or _SIZES
    print(conditions())
    print(
        "\n| stations | mobilecal (s) | Ceres (s) | ratio | growth of memory (MB) | cost apart | nine apart |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for size in sizes:
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory) / "extraction.npz"
            path.write_bytes(
                extraction_to_npz(ideal_extraction(paper_robot(), route_of(size, 0), DISTURBED, 0))
            )
            found = {}
            for solver in ("mobilecal", "ceres"):
                command = [sys.executable, "-m", "tests.bench.established", "one", solver, str(path)]
                text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                found[solver] = json.loads(text.splitlines()[-1])
        ours, theirs = found["mobilecal"], found["ceres"]
        apart = np.abs(np.array(ours["nine"]) / theirs["nine"] - 1).max()
        print(
            f"| {size} | {ours['seconds']:.2f} | {theirs['seconds']:.2f} | "
            f"{theirs['seconds'] / ours['seconds']:.1f} | {ours['mb']:.0f}, {theirs['mb']:.0f} | "
            f"{abs(ours['cost'] / theirs['cost'] - 1):.1e} | {apart:.1e} |"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
