"""Properties to include in a xacro file."""

from __future__ import annotations

from mobilecal_cli import se3
from mobilecal_cli.export.formats import CONVENTION, Exported, Source, frame_note, of_head_eye
from mobilecal_cli.export.text import decimal, rendered
from mobilecal_cli.model import FACTORS


def export(of: Source) -> Exported:
    """Properties to include"""
    robot, T, wheels = of.robot, of.robot.T_parent_child, of.robot.wheels
    values = {
        "head_eye_xyz": " ".join(decimal(float(value)) for value in T[:3, 3]),
        "head_eye_rpy": " ".join(decimal(float(value)) for value in se3.to_rpy(T[:3, :3])),
    }
    if robot.odometry is None:
        values |= {
            "wheel_radius_left": decimal(wheels.radius_left_m),
            "wheel_radius_right": decimal(wheels.radius_right_m),
            "wheel_separation": decimal(wheels.separation_m),
        }
    else:
        values |= {
            f"odometry_{name}": decimal(value)
            for name, value in zip(FACTORS, robot.factors.tolist(), strict=True)
        }
    note = f"Origin of {robot.child_frame} in {robot.parent_frame}: R = Rz(yaw) Ry(pitch) Rx(roll). {CONVENTION} "
    note += frame_note(robot)
    return of_head_eye(robot, rendered("xacro.xml", note=note, properties=values))
