"""mobilecal: head-eye and wheel calibration of a differential-drive robot from a recording.

In a notebook or a script:

    import mobilecal_cli as mc

    data = mc.extract("log.mcap", config="rig.yaml")
    fit = mc.solve(data)
    report = mc.Report(data, fit, gates={"point_rms_mm": 12})
    report.save("result")

Importing this package does no work: each name is loaded on first use.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # that of typing, whose import would take the time in which Ctrl-C prints a traceback
if TYPE_CHECKING:
    from typing import Any

    from mobilecal_cli.calibrate.export import export as export_to
    from mobilecal_cli.calibrate.load import Data
    from mobilecal_cli.calibrate.load import read_params as load
    from mobilecal_cli.calibrate.steps import Fit, Report, extract, solve
    from mobilecal_cli.comparison import difference as compare
    from mobilecal_cli.errors import MobilecalError
    from mobilecal_cli.measured import Drive, TargetPose, from_motions, from_poses
    from mobilecal_cli.model.observations import SensorMotion

__version__ = "0.1.0"
__all__ = [
    "Data",
    "Drive",
    "Fit",
    "MobilecalError",
    "Report",
    "SensorMotion",
    "TargetPose",
    "compare",
    "export_to",
    "extract",
    "from_motions",
    "from_poses",
    "load",
    "solve",
]


_ELSEWHERE = {
    "compare": ("comparison", "difference"),
    "Data": ("calibrate.load", "Data"),
    "export_to": ("calibrate.export", "export"),
    "Drive": ("measured", "Drive"),
    "from_motions": ("measured", "from_motions"),
    "from_poses": ("measured", "from_poses"),
    "MobilecalError": ("errors", "MobilecalError"),
    "SensorMotion": ("model.observations", "SensorMotion"),
    "TargetPose": ("measured", "TargetPose"),
    "load": ("calibrate.load", "read_params"),
}


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any public name
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, there = _ELSEWHERE.get(name, ("calibrate.steps", name))
    return getattr(import_module(f"{__name__}.{module}"), there)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return [*__all__, "__doc__", "__version__"]
