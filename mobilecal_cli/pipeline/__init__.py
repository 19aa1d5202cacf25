"""The stages of a calibration joined into commands; also the Python interface for notebooks.

Modules are imported on first use, so that a command loads only what it needs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mobilecal_cli.export import check_file, write_file
    from mobilecal_cli.pipeline.calibrating import calibrate, default_output, suggest
    from mobilecal_cli.pipeline.cluster import run_on
    from mobilecal_cli.pipeline.comparing import Comparison, Limits, compare
    from mobilecal_cli.pipeline.drafting import draft, write_draft
    from mobilecal_cli.pipeline.evaluating import Evaluated, evaluate
    from mobilecal_cli.pipeline.exporting import Exported, export
    from mobilecal_cli.pipeline.extracting import extract
    from mobilecal_cli.pipeline.fleet import batch, run_locally
    from mobilecal_cli.pipeline.inspecting import check, inspect, recordings
    from mobilecal_cli.pipeline.junit import write_junit, write_junit_error
    from mobilecal_cli.pipeline.printing import print_board
    from mobilecal_cli.pipeline.progress import Progress, silent

#: Name → module that defines it.
_HOME = {
    "Comparison": "comparing",
    "Evaluated": "evaluating",
    "Exported": "exporting",
    "Limits": "comparing",
    "Progress": "progress",
    "batch": "fleet",
    "calibrate": "calibrating",
    "check": "inspecting",
    "compare": "comparing",
    "default_output": "calibrating",
    "draft": "drafting",
    "evaluate": "evaluating",
    "export": "exporting",
    "extract": "extracting",
    "inspect": "inspecting",
    "print_board": "printing",
    "recordings": "inspecting",
    "run_locally": "fleet",
    "run_on": "cluster",
    "silent": "progress",
    "suggest": "calibrating",
    "write_draft": "drafting",
    "write_junit": "junit",
    "write_junit_error": "junit",
}
_FROM_EXPORT = ("check_file", "write_file")


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any exported name
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    if name in _FROM_EXPORT:
        return getattr(import_module("mobilecal_cli.export"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "Comparison",
    "Evaluated",
    "Exported",
    "Limits",
    "Progress",
    "batch",
    "calibrate",
    "check",
    "check_file",
    "compare",
    "default_output",
    "draft",
    "evaluate",
    "export",
    "extract",
    "inspect",
    "print_board",
    "recordings",
    "run_locally",
    "run_on",
    "silent",
    "suggest",
    "write_draft",
    "write_file",
    "write_junit",
    "write_junit_error",
]
