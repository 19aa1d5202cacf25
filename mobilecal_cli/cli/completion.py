"""Shell completion of the names before "=" in `--gate NAME=LIMIT` and `--set KEY=VALUE`."""

from __future__ import annotations

import typer


def gate_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Figures that `--gate` of this command can limit, each with "="."""
    from mobilecal_cli.report.verdict import gate_names

    names = gate_names(evaluating=ctx.info_name == "evaluate")
    return [f"{name}=" for name in names if name.startswith(incomplete)]


def setting_keys(incomplete: str) -> list[tuple[str, str]]:
    """Keys of rig.yaml, each with "=", and their descriptions."""
    from mobilecal_cli.config import setting_keys
    from mobilecal_cli.likelihood.nuisance import KINDS

    keys = dict(setting_keys())
    keys |= {f"priors.{kind.name}": f"{kind.meaning}, {kind.shown_unit}" for kind in KINDS}
    return [(f"{key}=", text) for key, text in keys.items() if key.startswith(incomplete)]
