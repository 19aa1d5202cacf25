"""JSON schema of report.json from its types: `python docs/generate/schema.py` writes the page in docs/reference."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pydantic import TypeAdapter

from mobilecal_cli.report.values import ReportData

REPOSITORY = Path(__file__).resolve().parents[2]
TARGET = REPOSITORY / "docs" / "reference" / "report.schema.json"


def schema() -> str:
    """The text of docs/reference/report.schema.json."""
    found = TypeAdapter(ReportData).json_schema(mode="serialization")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(head | _closed(found), indent=1, ensure_ascii=False) + "\n"


def _closed(node: object) -> object:
    """The schema without titles and defaults; an object has all of its keys, and no others."""
    if isinstance(node, list):
        return [_closed(item) for item in node]
    if not isinstance(node, dict):
        return node
    kept = {
        key: item for key, item in node.items() if key not in ("title", "default") or isinstance(item, dict)
    }
    found = {key: _closed(item) for key, item in kept.items()}
    if isinstance(found.get("description"), str):
        found["description"] = found["description"].partition("\n")[0]
    if "properties" in found:
        found |= {"required": sorted(found["properties"]), "additionalProperties": False}
    return found


if __name__ == "__main__":
    TARGET.write_text(schema(), encoding="utf-8")
    print(f"written: {TARGET.relative_to(REPOSITORY)}", file=sys.stderr)
